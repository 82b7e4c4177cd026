"""Starting poses from the colour images."""

from dataclasses import replace

import numpy as np
import pytest
from shared_data import ROOT

from adagmm_fusion.frames.depth_geometry import project
from adagmm_fusion.measurements.features import FeatureMatches
from adagmm_fusion.pairs.feature_start import MIN_INLIERS, depth_share, feature_starts, left_behind, match_features
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp

LIMITS = {"min_depth_m": 0.1, "max_depth_m": 5.0}


@pytest.fixture(scope="module")
def pair():
    return open_recording(ROOT / "recordings" / "two_kinects")[0]


@pytest.fixture(scope="module")
def matches(pair):
    return match_features(pair, **LIMITS)


@pytest.fixture(scope="module")
def starts(pair, matches):
    return feature_starts(matches, pair.target, max_depth_m=5.0)


def seen_at(points: np.ndarray, pair, T: np.ndarray) -> FeatureMatches:
    """Matches of points (n, 3) that are exactly where a pose puts them."""
    pixels = project(points @ T[:3, :3].T + T[:3, 3], pair.target.intrinsics).T
    inside = np.isfinite(pixels).all(axis=1)
    return FeatureMatches(points[inside], pixels[inside])


def test_features_of_the_shipped_recording_lead_near_its_rig(pair, starts):
    errors = pose_errors(pair.T_target_source, starts[0].T_target_source)
    assert errors.rotation_deg < 1.0
    assert errors.translation < 0.05
    assert MIN_INLIERS <= starts[0].inliers <= starts[0].matches
    assert len(starts[0].points) == len(starts[0].pixels) == starts[0].inliers


def test_the_same_images_give_the_same_bits(pair, starts):
    again = feature_starts(match_features(pair, **LIMITS), pair.target, max_depth_m=5.0)
    assert [a.T_target_source.tobytes() for a in again] == [a.T_target_source.tobytes() for a in starts]


def test_a_blank_image_leads_nowhere(pair):
    blank = replace(pair.target, color=np.full_like(pair.target.color, 128))
    matches = match_features(replace(pair, target=blank), **LIMITS)
    assert len(matches) == 0
    assert feature_starts(matches, blank, max_depth_m=5.0) == []


def test_features_without_depth_lead_nowhere(pair):
    assert len(match_features(pair, min_depth_m=0.01, max_depth_m=0.02)) == 0


def test_what_the_others_agree_on_is_asked_for_as_well(pair, starts):
    first, second = starts[0].points[::2], starts[0].points[1::2]
    fixed_to_the_image = seen_at(first, pair, np.eye(4))
    of_the_world = seen_at(second[: len(first) // 2], pair, pair.T_target_source)
    both = FeatureMatches(
        np.concatenate([fixed_to_the_image.points, of_the_world.points]),
        np.concatenate([fixed_to_the_image.pixels, of_the_world.pixels]),
    )
    deep = replace(pair.target, depth=np.zeros_like(pair.target.depth))  # its depth speaks against neither
    found = feature_starts(both, deep, max_depth_m=5.0)
    assert pose_errors(np.eye(4), found[0].T_target_source).rotation_deg < 0.1
    assert pose_errors(pair.T_target_source, found[1].T_target_source).rotation_deg < 0.1


@pytest.mark.parametrize("off", [(0, 0, 0, 0, 0, 40.0), (0, 0, 0, 0, 0, 0.6)])
def test_a_pose_beyond_sight_or_at_other_distances_is_left_out(pair, starts, off):
    T = se_exp(off) @ starts[0].T_target_source
    assert feature_starts(seen_at(starts[0].points, pair, T), pair.target, max_depth_m=5.0) == []


@pytest.mark.parametrize(
    ("inliers", "agreeing", "left"),
    [
        (288, 1, True),
        (274, 0, True),
        (30, 5, True),
        (30, 6, False),
        (29, 0, False),  # as few may have agreed by chance
        (63, 21, False),  # of a start on what is fixed to the camera, with a right end
        (300, MIN_INLIERS - 1, True),
        (300, MIN_INLIERS, False),
        (40, 53, False),
    ],
)
def test_features_are_left_behind_where_nearly_all_of_many_are(inliers, agreeing, left):
    said = left_behind(inliers, agreeing)
    assert (
        said.startswith(f"{inliers} image features agreed at the start, {agreeing} at the end: ") if left else not said
    )


def test_depth_is_asked_only_where_there_is_enough_of_it(pair, starts):
    assert depth_share(starts[0], pair.target, 5.0) > 0.9
    assert depth_share(starts[0], pair.target, 0.2) is None
