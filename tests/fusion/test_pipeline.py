"""From a pair to a judged outcome: success, failure and what cannot be registered, each said for what it is."""

import copy
import re
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from shared_data import ROOT, shared_data

from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.pairs.feature_start import MIN_INLIERS
from adagmm_fusion.pairs.pipeline import register_pair, run_pairs
from adagmm_fusion.pairs.record import pair_record
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.pairs.stages import stage_at
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

FEW_POINTS = Settings(target_points=2000, device="cpu")


@pytest.fixture(scope="module")
def pair() -> RGBDPair:
    return open_recording(ROOT / "recordings" / "two_kinects")[0]


@pytest.fixture(scope="module")
def outcome(pair):
    return register_pair(pair, FEW_POINTS)


def with_truth(pair: RGBDPair, T_target_source) -> RGBDPair:
    return RGBDPair(pair.name, pair.source, pair.target, T_target_source, pair.index)


def without_depth(pair: RGBDPair) -> RGBDPair:
    blind = replace(pair.source, depth=np.zeros_like(pair.source.depth))
    return RGBDPair(pair.name, blind, pair.target, pair.T_target_source, pair.index)


def test_the_shipped_pair_is_registered(outcome, pair):
    assert outcome.status == "ok" and outcome.reason == "" and outcome.judged_by == "ground truth"
    relative = pair.T_target_source[:3, :3] @ outcome.T_estimate[:3, :3].T
    angle_deg = np.rad2deg(np.arccos(np.clip((np.trace(relative) - 1.0) / 2.0, -1.0, 1.0)))
    assert angle_deg < 1.5
    assert np.linalg.norm(pair.T_target_source[:3, 3] - outcome.T_estimate[:3, 3]) < 0.05
    errors = outcome.evaluation.errors
    np.testing.assert_allclose(errors.rotation_deg, angle_deg, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(errors.rotation_frobenius, np.linalg.norm(np.eye(3) - relative), rtol=1e-9, atol=1e-12)


def test_depths_of_one_camera_are_off_alike(outcome, pair):
    source = replace(pair.source, sensor=pair.target.sensor)
    alone = register_pair(RGBDPair(pair.name, source, pair.target, pair.T_target_source, 0), FEW_POINTS)
    effects = outcome.depth_effects
    np.testing.assert_array_equal(alone.depth_effects, effects)
    both = effects[:, :2] + effects[:, 2:]
    noise = outcome.estimate.pose_covariance - effects @ effects.T
    np.testing.assert_allclose(alone.estimate.pose_covariance, noise + both @ both.T, rtol=0, atol=1e-12)
    assert np.trace(both @ both.T) < 0.7 * np.trace(effects @ effects.T)


def test_an_outcome_says_where_it_came_from(outcome, pair):
    initial = outcome.evaluation.initial_errors
    np.testing.assert_allclose(initial.translation, np.linalg.norm(pair.T_target_source[:3, 3]), rtol=1e-12)
    assert 25.0 < initial.rotation_deg < 35.0
    assert 1600 < len(outcome.source_cloud.points) < 2400
    assert outcome.seconds_clouds > 0.0 and outcome.seconds_registration > 0.0


@pytest.mark.slow
def test_colours_count_unless_they_are_told_not_to_or_say_nothing(outcome, pair):
    assert outcome.estimate.color is not None
    record = pair_record(outcome, FEW_POINTS)
    assert len(record.color_deviations) == 3 and 0.0 < record.color_lying < 0.6
    off = register_pair(pair, replace(FEW_POINTS, color="off"))
    grey = replace(pair.source, color=np.full_like(pair.source.color, 90))
    depth_only = register_pair(RGBDPair(pair.name, grey, pair.target, None, 0), replace(FEW_POINTS, start="geometry"))
    for other in (off, depth_only):
        assert other.estimate.color is None and pair_record(other, FEW_POINTS).color_lying is None
    with pytest.raises(InputError, match=r"^color: expected one of auto, off, got 'on'"):
        Settings(color="on")


def test_overlap_is_the_share_of_source_points_with_a_partner(outcome):
    source, target = np.asarray(outcome.source_cloud.points), np.asarray(outcome.target_cloud.points)
    for T, overlap in (
        (outcome.T_estimate, outcome.evaluation.overlap),
        (outcome.pair.T_target_source, outcome.evaluation.overlap_truth),
    ):
        moved = source @ T[:3, :3].T + T[:3, 3]
        nearest = np.sqrt(((moved[:, None] - target[None]) ** 2).sum(axis=2).min(axis=1))
        np.testing.assert_allclose(np.mean(nearest < outcome.evaluation.partner_distance_m), overlap, rtol=0, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ({"max_rotation_error_deg": 1e-4}, r"rotation error \d\.\d\d° is above 0\.0001°"),
        ({"max_translation_error_mm": 1e-3}, r"translation error \d+ mm is above 0\.001 mm"),
    ],
)
def test_an_error_above_a_limit_is_a_failure(pair, limits, reason):
    failed = register_pair(pair, replace(FEW_POINTS, **limits))
    assert failed.status == "failed"
    assert re.search(reason, failed.reason)
    assert failed.estimate is not None


@pytest.mark.slow
def test_a_wrong_ground_truth_shows(pair, outcome):
    wrong = pair.T_target_source.copy()
    wrong[0, 3] += 0.5
    failed = register_pair(with_truth(pair, wrong), FEW_POINTS)
    assert failed.status == "failed" and "translation error" in failed.reason
    assert failed.evaluation.overlap > failed.evaluation.overlap_truth + 0.1
    np.testing.assert_array_equal(failed.T_estimate, outcome.T_estimate)


@pytest.mark.slow
def test_without_ground_truth_the_estimate_judges_itself(pair, outcome):
    judged = register_pair(with_truth(pair, None), FEW_POINTS)
    assert judged.judged_by == "estimate"
    assert judged.evaluation.errors is None and judged.evaluation.overlap_truth is None
    assert (judged.status == "ok") == (not outcome.estimate.warnings)
    doubted = register_pair(with_truth(pair, None), replace(FEW_POINTS, min_overlap=0.99))
    assert doubted.status == "failed" and "is below 0.99" in doubted.reason


@pytest.mark.slow
def test_without_ground_truth_depth_and_colour_together_contradict(pair, outcome):
    """The target's depth image is made to see through the source, and its colours are turned over."""
    estimate = outcome.T_estimate
    end = stage_at(estimate, pair, outcome.source_cloud, outcome.target_cloud, 0.05)
    assert end.contradictions() == []
    far = replace(pair.target, depth=np.where(pair.target.depth > 0, 2 * pair.target.depth, 0).astype(np.uint16))
    dark = copy.deepcopy(outcome.target_cloud)
    dark.colors = o3d.utility.Vector3dVector(1.0 - np.asarray(dark.colors))
    end = stage_at(estimate, replace(pair, target=far), outcome.source_cloud, dark, 0.05)
    depth, colour = end.contradictions()
    assert depth.endswith("% of the source lies in front of the target's surfaces")
    assert colour.startswith("colour contradicts (correlation -")


def test_colours_that_contradict_the_depth_are_told(pair):
    """A frame and itself with its colours moved by 12 pixels: the features turn the camera, the depth does not."""
    target = pair.target
    moved = replace(target, color=np.roll(target.color, 12, axis=1))
    record = pair_record(register_pair(RGBDPair("moved", moved, target, None, 0), FEW_POINTS), FEW_POINTS)
    told = f"{record.feature_inliers} image features agreed at the start, {record.agreeing_features} at the end"
    assert record.feature_inliers > 1000 and record.agreeing_features < MIN_INLIERS
    assert record.status == "failed" and not record.trustworthy
    assert record.warnings[-1].startswith(told) and told in record.diagnosis and told in record.reason


def test_a_frame_without_depth_is_a_failure_with_its_reason(pair):
    failed = register_pair(without_depth(pair), FEW_POINTS)
    assert failed.status == "failed" and failed.judged_by == "error"
    assert "cloud is empty" in failed.reason and "\n" not in failed.reason
    assert failed.estimate is None and failed.source_cloud is None and failed.T_estimate is None
    assert failed.pair is not None


@pytest.mark.slow
def test_the_callback_sees_every_iteration(pair):
    seen = []
    outcome = register_pair(pair, FEW_POINTS, seen.append)
    assert [step["iteration_index"] for step in seen] == list(range(outcome.estimate.iterations))


@pytest.mark.slow
def test_a_damaged_pair_does_not_stop_the_others(tmp_path):
    folder = _copy_of_shipped(tmp_path)
    image = folder / "right" / "depth" / "000001.png"
    image.write_bytes(image.read_bytes()[:5000])
    recording = open_recording(folder)
    outcomes = list(run_pairs(recording, FEW_POINTS, [0, 1, 2]))
    assert [outcome.status for outcome in outcomes] == ["ok", "failed", "ok"]
    assert outcomes[1].judged_by == "error" and outcomes[1].pair is None
    assert str(image) in outcomes[1].reason
    assert [outcome.pair_name for outcome in outcomes] == [recording.pair_name(i) for i in range(3)]


def _copy_of_shipped(tmp_path):
    import shutil

    shutil.copytree(ROOT / "recordings" / "two_kinects", tmp_path / "recordings" / "two_kinects")
    shutil.copytree(ROOT / "calibration", tmp_path / "calibration")
    return tmp_path / "recordings" / "two_kinects"


@pytest.mark.parametrize(
    "name", ["voxel_size_m", "target_points", "max_depth_m", "max_iteration", "partner_distance_m"]
)
@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf")])
def test_settings_are_checked_when_they_are_made(name, value):
    with pytest.raises(InputError, match=f"^{name}: expected a positive number"):
        Settings(**{name: value})


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan")])
def test_the_least_overlap_is_a_share(value):
    with pytest.raises(InputError, match=r"^min_overlap: expected a share"):
        Settings(min_overlap=value)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hololens_tof", "redwood_open3d_5frames"])
def test_real_recordings_are_registered(name):
    recording = open_recording(shared_data("recordings", name))
    outcomes = list(run_pairs(recording, Settings(device="cpu"), range(len(recording))))
    errors_deg = [outcome.evaluation.errors.rotation_deg for outcome in outcomes]
    assert np.median(errors_deg) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("source", "target"), [(28, 13), (18, 10), (5, 2)])
def test_a_room_seen_from_other_sides_is_laid_on_itself_by_what_its_walls_face(source, target):
    """Features find none of these; a door along the corridor, or half a turn, once passed for them."""
    entries = open_recording(shared_data("recordings", "hololens_tof")).entries
    one, other = entries[source], entries[target]
    T = se_inverse(other.T_world_camera) @ one.T_world_camera
    pair = RGBDPair("other sides", one.load(), other.load(), T, 0)
    outcome = register_pair(pair, Settings(start="features", device="cpu"))
    errors = outcome.evaluation.errors
    assert errors.rotation_deg < 1.5 and errors.translation < 0.1
