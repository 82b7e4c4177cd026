"""When the colour images confirm a pose, and when they do not."""

from dataclasses import replace

import pytest
from shared_data import ROOT

from adagmm_fusion.pairs.feature_start import find_feature_start
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.sequence.confirmation import depth_confirms, features_confirm
from adagmm_o3d import lie


@pytest.fixture(scope="module")
def pair():
    return open_recording(ROOT / "recordings" / "two_kinects")[0]


@pytest.fixture(scope="module")
def features(pair):
    return find_feature_start(pair, min_depth_m=0.1, max_depth_m=5.0)


def test_features_of_the_same_place_are_confirmed(pair, features):
    assert len(features.points) == len(features.pixels) == features.inliers
    assert depth_confirms(features, pair.target, 5.0)
    assert features_confirm(features, pair.target, features.T_target_source)
    assert features_confirm(
        features, pair.target, lie.se_exp((0.0, 0.005, 0.0, 0.0, 0.0, 0.0)) @ features.T_target_source
    )


@pytest.mark.parametrize("off", [(0.0, 0.1, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.3, 0.0, 0.0)])
def test_a_pose_that_slid_away_is_not(pair, features, off):
    assert not features_confirm(features, pair.target, lie.se_exp(off) @ features.T_target_source)


def test_neither_is_one_at_other_distances_or_without_depth(pair, features):
    farther = replace(features, T_target_source=lie.se_exp((0, 0, 0, 0, 0, 0.6)) @ features.T_target_source)
    assert not depth_confirms(farther, pair.target, 5.0)
    assert not depth_confirms(features, pair.target, 0.2)
