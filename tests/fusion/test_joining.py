"""Parts of a recording joined by registrations of which none is believed alone."""

from dataclasses import replace

import numpy as np
import pytest
from depth_scene import camera_pose, write_pose_file

import adagmm_fusion.sequence.registration as registration
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.sequence.edge_file import EdgeFile
from adagmm_fusion.sequence.edges import NOT_CONFIRMED, Edge
from adagmm_fusion.sequence.joining import joined
from adagmm_fusion.sequence.loop_candidates import EVENLY, evenly
from adagmm_fusion.sequence.pose_graph import connected_sets, optimized_poses
from adagmm_fusion.sequence.scene import scene_of
from adagmm_o3d import lie
from adagmm_o3d.lie import se_inverse

FRAMES = range(8)
NEARLY = (0.005, -0.01, 0.005, 0.015, 0.025, -0.02)
AWAY, ELSEWHERE = (0.0, 0.0, 0.5, 1.0, 0.0, 0.0), (0.0, 1.5, 0.0, 0.0, 2.0, 0.0)


class Walk:
    """Two parts, 0 to 3 and 4 to 7, each held together; the true poses of all."""

    def __init__(self, seed=0):
        rng = np.random.default_rng(seed)
        self.true = [np.eye(4)]
        for _ in FRAMES[1:]:
            self.true.append(self.true[-1] @ lie.se_exp(rng.normal(0.0, 0.3, 6)))
        self.parts = [self.edge(i + 1, i, reason="") for i in (0, 1, 2, 4, 5, 6)]

    def edge(self, source, target, off=(0.0,) * 6, reason="overlap 0.30 is below 0.6"):
        T = se_inverse(self.true[target]) @ lie.se_exp(off) @ self.true[source]
        return Edge(source, target, T, 1000.0 * np.eye(6), False, reason)


def sizes(edges):
    return [len(part) for part in connected_sets(edges, FRAMES)]


def test_several_that_nearly_say_the_same_join_two_parts_whichever_way_they_go():
    walk = Walk()
    doubtful = [walk.edge(4, 0), walk.edge(2, 5, NEARLY), walk.edge(6, 3, tuple(-x for x in NEARLY))]
    edges = joined([*walk.parts, *doubtful], FRAMES)
    assert sizes(edges) == [8]
    assert all(edge.usable and edge.loop_closure for edge in edges[6:])
    poses, dropped = optimized_poses(edges)
    assert not dropped
    for frame in FRAMES:
        np.testing.assert_allclose(poses[frame], walk.true[frame], rtol=0, atol=0.15)


@pytest.mark.parametrize(
    "offs",
    [
        [(0.0,) * 6, NEARLY],
        [(0.0,) * 6, NEARLY, AWAY],
        [AWAY, ELSEWHERE, (0.0,) * 6, NEARLY],
    ],
)
def test_two_that_say_the_same_are_too_few(offs):
    walk = Walk(1)
    pairs = [(4, 0), (5, 1), (6, 2), (7, 3)]
    doubtful = [walk.edge(*pair, off) for pair, off in zip(pairs, offs, strict=False)]
    assert joined([*walk.parts, *doubtful], FRAMES) == [*walk.parts, *doubtful]


def test_as_many_that_say_something_else_leave_the_parts_apart():
    walk = Walk(2)
    here = [walk.edge(4, 0), walk.edge(5, 1), walk.edge(6, 2), walk.edge(7, 3)]
    there = [walk.edge(*pair, AWAY) for pair in ((4, 1), (5, 2), (6, 3))]
    assert sizes(joined([*walk.parts, *here, *there], FRAMES)) == [4, 4]
    edges = joined([*walk.parts, *here, *there[:2]], FRAMES)
    assert sizes(edges) == [8]
    assert [edge.usable for edge in edges[6:]] == [True] * 4 + [False] * 2


def test_the_same_two_frames_the_other_way_round_count_once():
    walk = Walk(1)
    doubtful = [walk.edge(4, 0), walk.edge(0, 4), walk.edge(5, 1)]
    assert joined([*walk.parts, *doubtful], FRAMES) == [*walk.parts, *doubtful]


def test_what_has_no_pose_or_lies_within_a_part_confirms_nothing():
    walk = Walk(3)
    without = [replace(walk.edge(*pair), transformation=None, information=None) for pair in ((4, 0), (5, 1), (6, 2))]
    within = [walk.edge(2, 0), walk.edge(3, 1), walk.edge(3, 0)]
    assert joined([*walk.parts, *without, *within], FRAMES) == [*walk.parts, *without, *within]


def test_a_part_that_has_been_joined_joins_the_next():
    """Frame 7 alone agrees with one frame of each of the other parts, and two of the whole."""
    walk = Walk(4)
    doubtful = [walk.edge(4, 0), walk.edge(5, 1), walk.edge(6, 2), walk.edge(7, 3), walk.edge(7, 4), walk.edge(7, 1)]
    edges = joined([*walk.parts[:-1], *doubtful], FRAMES)
    assert sizes(edges) == [8] and all(edge.usable for edge in edges)


@pytest.mark.parametrize("count", [2, 3, 7, 45, 46, 300])
def test_pairs_are_taken_evenly_and_no_more_than_so_many(count):
    frames = tuple(range(count))
    pairs = evenly(frames, {frame: frame for frame in frames})
    gaps = [later - earlier for later, earlier in pairs]
    assert len(set(pairs)) == len(pairs) == min(EVENLY, count * (count - 1) // 2)
    assert gaps == sorted(gaps) and gaps[0] == 1 and gaps[-1] == count - 1


def test_frames_of_one_moment_are_no_pair():
    assert evenly((0, 1, 2), {0: 0, 1: 0, 2: 1}) == [(2, 1), (2, 0)]


def test_a_doubtful_registration_is_found_again_and_what_was_not_looked_at_gives_way(tmp_path):
    walk, path = Walk(5), tmp_path / "edges.jsonl"
    file = EdgeFile(path, {}, 8)
    file.add(Edge(4, 0, None, None, True, NOT_CONFIRMED))
    file.add(walk.edge(4, 0))
    for opened in (file, EdgeFile(path, {}, 8)):
        (edge,) = opened.edges
        assert edge.doubtful and not edge.usable and opened.find(4, 0) is edge
        np.testing.assert_allclose(edge.transformation, walk.edge(4, 0).transformation)


def test_frames_of_parts_are_registered_until_nothing_is_apart(tmp_path, monkeypatch):
    """Between frames 0 to 2 and 3 to 5 nothing is believed, and three doubtful registrations are enough."""
    intrinsics = PinholeIntrinsics(40, 30, 35.0, 35.0, 19.5, 14.5)
    poses = [camera_pose(5.0 * i, (0.05 * i, 0.0, 1.2)) for i in range(6)]
    write_pose_file(tmp_path / "room", poses, intrinsics)
    recording, tried = open_recording(tmp_path / "room"), []

    def registered(pair, source, target, settings, *, loop_closure, confirmed_only=False, joining=False):
        apart = (source > 2) != (target > 2)
        assert not joining or apart
        if apart and (confirmed_only or source - target < 3):
            return Edge(source, target, None, None, loop_closure, NOT_CONFIRMED if confirmed_only else "no overlap")
        tried.append((source, target))
        T = se_inverse(poses[target]) @ poses[source]
        return Edge(source, target, T, np.eye(6), loop_closure, "overlap 0.30 is below 0.6" if apart else "")

    monkeypatch.setattr(registration, "registered_edge", registered)
    file, scene = EdgeFile(tmp_path / "edges.jsonl", {}, 6), scene_of(recording)
    registration.register_scene(recording, scene, Settings(device="cpu"), file, lambda *_: None)
    assert [pair for pair in tried if pair[0] > 2 >= pair[1]] == [(3, 0), (4, 1), (5, 2)]
    assert len(connected_sets(joined(file.edges, scene.frames), scene.frames)) == 1
    assert sum(edge.doubtful for edge in file.edges) == 3
