"""Poses that compete: a registration that slid away, features that are fixed to the image, and the right one."""

import numpy as np
import pytest
from shared_data import ROOT

from adagmm_fusion.measurements.features import FeatureMatches, FeatureMeasurements
from adagmm_fusion.measurements.joint_pose import Measurements
from adagmm_fusion.measurements.surfaces import SurfaceMeasurements
from adagmm_fusion.pairs.candidates import are_near, compete
from adagmm_fusion.pairs.feature_start import match_features
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp, se_inverse

SLID = (0.0, 0.4, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def pair():
    return open_recording(ROOT / "recordings" / "two_kinects")[1]


@pytest.fixture(scope="module")
def surfaces(pair):
    return SurfaceMeasurements(pair, sensor_model="kinect-surface", min_depth_m=0.1, max_depth_m=5.0)


@pytest.fixture(scope="module")
def matches(pair):
    return match_features(pair, min_depth_m=0.1, max_depth_m=5.0)


def measurements(pair, surfaces, matches) -> Measurements:
    return Measurements(surfaces, FeatureMeasurements(matches, pair.source.intrinsics, pair.target.intrinsics))


@pytest.mark.slow
@pytest.mark.parametrize("order", [1, -1])
def test_a_registration_that_slid_away_loses_to_features(pair, surfaces, matches, order):
    right = se_exp((0.002, 0.0, 0.001, 0.005, 0.0, 0.0)) @ pair.T_target_source
    proposed = [se_exp(SLID) @ pair.T_target_source, right][::order]
    winner = compete(measurements(pair, surfaces, matches), proposed)
    errors = pose_errors(pair.T_target_source, winner.joint.T_target_source)
    assert errors.rotation_deg < 0.06 and errors.translation < 3e-3
    assert winner.agreeing > 100 and winner.lead > 100.0


def test_features_that_are_fixed_to_the_image_do_not_win(pair, surfaces):
    depth = pair.source.depth_m()
    v, u = np.mgrid[40:440:60, 40:600:60].reshape(2, -1)
    known = np.isfinite(depth[v, u])
    v, u = v[known], u[known]
    k, z = pair.source.intrinsics, depth[v, u]
    points = np.column_stack([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z]).astype(float)
    stuck = FeatureMatches(points, np.column_stack([u, v]).astype(float))
    assert len(stuck) > 30
    winner = compete(measurements(pair, surfaces, stuck), [np.eye(4), pair.T_target_source])
    assert pose_errors(pair.T_target_source, winner.joint.T_target_source).rotation_deg < 0.1


def test_one_candidate_has_no_rival(pair, surfaces):
    winner = compete(Measurements(surfaces, None), [pair.T_target_source])
    assert winner.lead == np.inf and winner.agreeing == 0


def test_poses_are_near_by_turn_and_by_place():
    T = se_exp((0.3, -0.2, 0.1, 0.5, 0.2, 3.0))
    assert are_near(T, T, 0.1, 1e-6)
    assert not are_near(T, se_exp((0.0, 0.0, 0.0, 0.0, 0.0, 0.1)) @ T, 0.1, 0.05)
    assert not are_near(T, se_exp((0.02, 0.0, 0.0, 0.0, 0.0, 0.0)) @ T, 0.1, 10.0)
    assert are_near(se_inverse(T), se_inverse(se_exp((1e-4, 0, 0, 0, 0, 0)) @ T), 0.1, 0.01)
