"""Starting poses from the colour images."""

from dataclasses import replace

import numpy as np
import pytest
from shared_data import ROOT

from adagmm_fusion.pairs.feature_start import MIN_INLIERS, find_feature_start
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.evaluation import pose_errors

LIMITS = {"min_depth_m": 0.1, "max_depth_m": 5.0}


@pytest.fixture(scope="module")
def pair():
    return open_recording(ROOT / "recordings" / "two_kinects")[0]


def test_features_of_the_shipped_recording_lead_near_its_rig(pair):
    start = find_feature_start(pair, **LIMITS)
    errors = pose_errors(pair.T_target_source, start.T_target_source)
    assert errors.rotation_deg < 1.0
    assert errors.translation < 0.05
    assert MIN_INLIERS <= start.inliers <= start.matches


def test_the_same_images_give_the_same_bits(pair):
    first, second = (find_feature_start(pair, **LIMITS) for _ in range(2))
    assert first.T_target_source.tobytes() == second.T_target_source.tobytes()


def test_a_blank_image_leads_nowhere(pair):
    blank = replace(pair.target, color=np.full_like(pair.target.color, 128))
    assert find_feature_start(replace(pair, target=blank), **LIMITS) is None


def test_features_without_depth_lead_nowhere(pair):
    assert find_feature_start(pair, min_depth_m=0.01, max_depth_m=0.02) is None
