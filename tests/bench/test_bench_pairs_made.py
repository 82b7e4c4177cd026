"""The pairs that `adagmm-bench pairs` makes are what they are called: pieces, strangers, misleading starts."""

import numpy as np
import pytest
from pair_files import pose, write_pair
from shared_data import shared_data

from adagmm_bench.models import make_blob
from adagmm_bench.pairs import made, overlap, trust
from adagmm_bench.pairs.made import CASES, DIFFERENT_ROOMS, MadePair, room_pools
from adagmm_bench.pairs.motions import about, rigid, turn, with_moved_source
from adagmm_bench.pairs.overlap import ANYWHERE, MODELS, NEAR, NEAR_DEG, ROOMS, SHARES, OverlapPair, cut
from adagmm_bench.pairs.problem import plain_pair
from adagmm_bench.pairs.public import PublicPair
from adagmm_bench.pairs.trust import RANDOM_START, WRONG_START, KinectPair, Restarted
from adagmm_bench.scenes import KinectScene
from adagmm_o3d import lie
from adagmm_o3d.evaluation import overlap_ratio, rotation_error_deg


@pytest.mark.parametrize("share", SHARES)
def test_the_share_is_that_of_the_smaller_piece(share):
    points = make_blob(0)
    lower, upper = cut(points, points, np.array([0.3, -1.0, 0.5]), share)
    common = len({*map(tuple, lower)} & {*map(tuple, upper)})
    np.testing.assert_allclose(common / min(len(lower), len(upper)), share, rtol=0, atol=0.005)
    assert len({*map(tuple, lower)} | {*map(tuple, upper)}) == len(points)


@pytest.mark.parametrize("start", [NEAR, ANYWHERE])
def test_pieces_of_models_fit_at_the_truth_and_only_the_share_does(start):
    angles, again = [], OverlapPair(MODELS, 0.4, start, 1, 7)
    for trial in range(6):
        pair = OverlapPair(MODELS, 0.4, start, trial, 7).load()
        source, target = np.asarray(pair.source.points), np.asarray(pair.target.points)
        share = overlap_ratio(source, target, pair.T_target_source, 0.03)
        assert 0.36 < share < 0.5
        angles.append(rotation_error_deg(np.eye(4), pair.T_target_source))
    assert (max(angles) <= NEAR_DEG + 1e-6) == (start == NEAR)
    first = np.asarray(again.load().source.points)
    overlap._load.cache_clear()
    np.testing.assert_array_equal(np.asarray(again.load().source.points), first)


def test_trials_of_one_number_share_their_motion():
    poses = [OverlapPair(MODELS, share, NEAR, 3, 0).load().T_target_source for share in SHARES]
    np.testing.assert_array_equal(np.ptp(poses, axis=0), np.zeros((4, 4)))


def test_rooms_are_sampled_anew_and_cut(tmp_path):
    path = tmp_path / "room.npz"
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(0.0, 4.0, (40_000, 2)), np.zeros(40_000)])
    np.savez(path, source=floor, target=floor, T=np.eye(4))
    pair = OverlapPair(ROOMS, 0.5, ANYWHERE, 0, 0, rooms=(path,)).load()
    source, target = np.asarray(pair.source.points), np.asarray(pair.target.points)
    assert pair.limits == (5.0, 0.2) and pair.unit == 1.0
    np.testing.assert_allclose(overlap_ratio(source, target, pair.T_target_source, 0.05), 0.5, rtol=0, atol=0.05)
    assert overlap_ratio(source, target, pair.T_target_source, 1e-4) < 0.01


def test_a_moved_source_keeps_the_pair():
    points = make_blob(1)
    T = pose(25.0, 0.4)
    pair = plain_pair((points - T[:3, 3]) @ T[:3, :3], points, T, source_viewpoint=np.array([1.0, 2.0, 3.0]))
    rng = np.random.default_rng(5)
    motion = about(np.array([1.0, 0.0, 2.0]), rigid(turn(rng, None), rng.standard_normal(3)))
    moved = with_moved_source(pair, motion)
    for before, after in (
        (np.asarray(pair.source.points), np.asarray(moved.source.points)),
        (pair.centre[None], moved.centre[None]),
        (pair.source_viewpoint[None], moved.source_viewpoint[None]),
    ):
        a, b = pair.T_target_source, moved.T_target_source
        np.testing.assert_allclose(after @ b[:3, :3].T + b[:3, 3], before @ a[:3, :3].T + a[:3, 3], rtol=0, atol=1e-9)
    np.testing.assert_allclose(about(np.ones(3), motion)[:3, :3], motion[:3, :3], rtol=0, atol=0)
    np.testing.assert_allclose(
        lie.so_log(turn(rng, 30.0)) @ lie.so_log(turn(rng, 30.0)) <= np.radians(30.0) ** 2, True, rtol=0, atol=0
    )


def test_misleading_starts_keep_the_truth(tmp_path):
    path = tmp_path / "one.npz"
    write_pair(path, pose(12.0, 3.0))
    base = PublicPair(path)
    wrong = Restarted(base, WRONG_START, 4, 0).load()
    assert 60.0 <= rotation_error_deg(wrong.T_target_source, wrong.init) <= 180.0
    np.testing.assert_array_equal(wrong.T_target_source, base.load().T_target_source)
    moved = Restarted(base, RANDOM_START, 4, 0).load()
    source, target = np.asarray(moved.source.points), np.asarray(moved.target.points)
    assert overlap_ratio(source, target, moved.T_target_source, 1.0) > 0.8
    np.testing.assert_array_equal(moved.init, np.eye(4))
    assert Restarted(base, RANDOM_START, 4, 0).facts()["group"] == "clouds, random start"


@pytest.mark.parametrize("case", [case for case in CASES if case != DIFFERENT_ROOMS])
def test_made_pairs_are_what_they_are_called(case):
    pairs = [MadePair(case, trial, 3, None) for trial in range(4)]
    clouds = [pair.load() for pair in pairs]
    made._make.cache_clear()
    np.testing.assert_array_equal(np.asarray(pairs[0].load().source.points), np.asarray(clouds[0].source.points))
    for one in clouds:
        source, target = np.asarray(one.source.points), np.asarray(one.target.points)
        if case == "copies of few points":
            assert overlap_ratio(source, target, one.T_target_source, 1e-6) == 1.0
        elif case == "half a turn off":
            assert overlap_ratio(source, target, one.T_target_source, 0.2) > 0.99
            assert rotation_error_deg(one.T_target_source, np.eye(4)) > 170.0
            for half_turn in np.diag([1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, -1.0]), np.diag([-1.0, -1.0, 1.0]):
                assert 0.9 < overlap_ratio(target, target, rigid(half_turn, np.zeros(3)), 0.15) < 0.98
        else:
            assert one.T_target_source is None and not one.related


def test_kinect_scenes_fit_at_their_truth():
    path = shared_data("kinect_pairs", "scene_03.npz")
    clouds = KinectPair(KinectScene(path)).load()
    assert np.isfinite(np.asarray(clouds.source.covariances)).all() and clouds.limits == trust.KINECT_FOUND
    source, target = np.asarray(clouds.source.points), np.asarray(clouds.target.points)
    assert overlap_ratio(source, target, clouds.T_target_source, 0.05) > 0.3


def test_pieces_of_one_room_are_of_one_room():
    rooms = room_pools(shared_data("cloud_pairs").parent)[1]
    assert [len(pool) for pool in rooms.values()] == [2, 1]


@pytest.mark.slow
def test_different_rooms_come_from_different_recordings():
    folder = shared_data("cloud_pairs").parent
    shared_data("recordings")
    pair = MadePair(DIFFERENT_ROOMS, 0, 0, folder)
    clouds = pair.load()
    assert pair.facts()["viewpoints"] and not MadePair(DIFFERENT_ROOMS, 1, 0, folder).facts()["viewpoints"]
    assert clouds.source_viewpoint is not None and not clouds.related and clouds.T_target_source is None
