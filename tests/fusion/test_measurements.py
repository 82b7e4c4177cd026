"""Surfaces and features as measurements of a pose: their derivatives, their evidence, and the pose of both."""

from dataclasses import replace

import numpy as np
import pytest
from shared_data import ROOT

from adagmm_fusion.frames.depth_geometry import back_project, project
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame, RGBDPair
from adagmm_fusion.measurements.depth_errors import SCALE, SHIFT_M
from adagmm_fusion.measurements.features import FeatureMatches, FeatureMeasurements
from adagmm_fusion.measurements.joint_pose import MANY, SOME, Measurements, refine
from adagmm_fusion.measurements.residuals import Residuals, counted_once, normal_equations
from adagmm_fusion.measurements.surfaces import SurfaceMeasurements
from adagmm_fusion.pairs.feature_start import match_features
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp, se_log

INTRINSICS = PinholeIntrinsics(320, 240, 260.0, 262.0, 159.5, 119.5)
DISTORTED = replace(INTRINSICS, distortion=(0.1, -0.05, 0.001, -0.002, 0.01))
LIMITS = {"sensor_model": "kinect-surface", "min_depth_m": 0.1, "max_depth_m": 5.0}
OFF = (0.02, -0.01, 0.015, 0.02, -0.03, 0.01)


def frame(depth: np.ndarray, intrinsics: PinholeIntrinsics = INTRINSICS) -> RGBDFrame:
    color = np.zeros((*depth.shape, 3), np.uint8)
    return RGBDFrame(
        name="0",
        sensor="left",
        color=color,
        depth=(depth * 1e4).astype(np.uint16),
        depth_scale=1e4,
        intrinsics=intrinsics,
    )


def wall(tilt: float = 0.3) -> np.ndarray:
    """(240, 320) depth [m] of a wall that leans."""
    v, u = np.indices((240, 320))
    return 1.0 / (0.5 + tilt * (u - 159.5) / 260.0 + 0.1 * (v - 119.5) / 262.0)


def corner() -> np.ndarray:
    """(240, 320) depth [m] where three walls meet."""
    v, u = np.indices((240, 320))
    x, y = (u - 159.5) / 260.0, (v - 119.5) / 262.0
    return 1.0 / np.maximum.reduce([0.5 + 0.3 * x + 0.1 * y, 0.5 - 0.4 * x + 0.1 * y, 0.55 + 0.6 * y])


@pytest.fixture(scope="module")
def shipped() -> RGBDPair:
    return open_recording(ROOT / "recordings" / "two_kinects")[0]


@pytest.fixture(scope="module")
def measured(shipped) -> Measurements:
    matches = match_features(shipped, min_depth_m=0.1, max_depth_m=5.0)
    features = FeatureMeasurements(matches, shipped.source.intrinsics, shipped.target.intrinsics)
    return Measurements(SurfaceMeasurements(shipped, **LIMITS), features)


@pytest.mark.parametrize("intrinsics", [INTRINSICS, DISTORTED], ids=["pinhole", "distorted"])
def test_projecting_undoes_back_projecting(intrinsics):
    points = back_project(corner(), intrinsics).reshape(-1, 3)
    v, u = np.indices((240, 320))
    np.testing.assert_allclose(project(points, intrinsics), [u.ravel(), v.ravel()], rtol=0, atol=1e-4)
    assert np.isnan(project(-points[:5], intrinsics)).all()


def test_residuals_follow_their_derivatives(shipped, measured):
    T = shipped.T_target_source
    features, size = measured.features, 1e-6
    kept = features._residuals(T)[0]
    agree = (kept.values**2).sum(axis=1) < 9.0
    for axis, step in enumerate(size * np.eye(6)):
        after, before = (features._residuals(se_exp(sign * step) @ T)[0].values for sign in (1.0, -1.0))
        # The covariances turn with the pose as well, which the derivatives, of some hundreds per radian, leave out.
        change = (after - before)[agree] / (2.0 * size)
        np.testing.assert_allclose(change, kept.jacobians[agree, :, axis], rtol=0.05, atol=15.0)


def test_the_surfaces_of_a_corner_bring_a_pose_back():
    here = RGBDPair("corner", frame(corner()), frame(corner()), None, 0)
    surfaces = SurfaceMeasurements(here, **LIMITS)
    found = refine(Measurements(surfaces, None), se_exp(OFF), MANY)
    errors = pose_errors(np.eye(4), found.T_target_source)
    assert errors.rotation_deg < 0.01 and errors.translation < 2e-4
    points = back_project(corner(), INTRINSICS).reshape(-1, 3)
    assert found.uncertainty(points).unobservable == ()


def test_a_wall_leaves_three_directions_that_features_hold():
    depth = wall()
    here = RGBDPair("wall", frame(depth), frame(depth), None, 0)
    surfaces = SurfaceMeasurements(here, **LIMITS)
    points = back_project(depth, INTRINSICS).reshape(-1, 3)
    start = se_exp(OFF)
    alone = refine(Measurements(surfaces, None), start, MANY)
    assert len(alone.uncertainty(points).unobservable) == 3
    some = points[:: len(points) // 40]
    features = FeatureMeasurements(FeatureMatches(some, project(some, INTRINSICS).T), INTRINSICS, INTRINSICS)
    both = refine(Measurements(surfaces, features), start, MANY)
    uncertainty = both.uncertainty(points)
    assert uncertainty.unobservable == ()
    errors = pose_errors(np.eye(4), both.T_target_source)
    assert errors.rotation_deg < 0.05 and errors.translation < 1e-3
    assert np.linalg.eigvalsh(uncertainty.covariance)[-1] < 0.02**2
    # Along the wall, where nothing holds it, the pose is as uncertain as the wall is wide.
    assert np.sqrt(np.linalg.eigvalsh(alone.uncertainty(points).covariance)[-1]) > 0.5


def surfaces_of(source: np.ndarray, target: np.ndarray) -> Measurements:
    return Measurements(SurfaceMeasurements(RGBDPair("pair", frame(source), frame(target), None, 0), **LIMITS), None)


@pytest.mark.parametrize("kind", range(4), ids=["source scale", "source shift", "target scale", "target shift"])
def test_an_error_of_all_depths_moves_the_pose_as_the_covariance_has_it(kind):
    size, depths = 0.004, [corner(), corner()]
    depths[kind // 2] = depths[kind // 2] * (1.0 + size) if kind % 2 == 0 else depths[kind // 2] + size
    right = refine(surfaces_of(corner(), corner()), np.eye(4), MANY)
    moved = se_log(refine(surfaces_of(*depths), np.eye(4), MANY).T_target_source)
    points = back_project(corner(), INTRINSICS).reshape(-1, 3)
    expected = -right.depth_effects(points)[:, kind] * size / (SCALE, SHIFT_M)[kind % 2]
    assert np.linalg.norm(moved - expected) < 0.1 * np.linalg.norm(expected)


def test_both_together_find_the_shipped_pose(shipped, measured):
    start = se_exp((0.003, -0.003, 0.002, 0.01, 0.0, -0.01)) @ shipped.T_target_source
    found = refine(measured, start, MANY)
    errors = pose_errors(shipped.T_target_source, found.T_target_source)
    assert errors.rotation_deg < 0.04 and errors.translation < 2e-3


@pytest.mark.parametrize("off", [(0.0, 0.1, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.2, 0.0, 0.0)])
def test_both_speak_for_the_right_pose(shipped, measured, off):
    T = shipped.T_target_source
    scale = measured.scale(T)
    at_truth, elsewhere = (np.array(measured.evidence(pose, scale)) for pose in (T, se_exp(off) @ T))
    assert (at_truth > elsewhere + 100.0).all()
    assert measured.agreeing(T) > 100 > measured.agreeing(se_exp(off) @ T)


def test_errors_that_go_together_count_as_few():
    rng = np.random.default_rng(0)
    places = rng.uniform(0.0, 2.0, (4000, 3)) * [1.0, 1.0, 0.0]
    jacobians = rng.normal(size=(4000, 1, 6))
    jacobians[:, :, 0] = 1.0
    by_depth = np.zeros((4000, 1, 4))
    apart = normal_equations(Residuals(rng.normal(size=(4000, 1)), jacobians, by_depth, places), 1e-4)
    assert apart.correlation < 2.0
    shared = rng.normal(size=64)[(np.floor(places[:, 0] / 0.25) * 8 + np.floor(places[:, 1] / 0.25)).astype(int)]
    together = normal_equations(Residuals(shared[:, None], jacobians, by_depth, places), 1e-4)
    assert together.correlation > 5.0
    np.testing.assert_allclose(together.information, together.hessian / together.correlation, rtol=1e-12, atol=0)


def test_what_lies_in_one_cell_counts_once():
    places = np.array([[0.01, 0.0, 1.0], [0.02, 0.0, 1.0], [0.55, 0.0, 1.0]])
    np.testing.assert_allclose(counted_once(places, np.array([1.0, 3.0, 5.0])), 7.0, rtol=1e-12)
    assert counted_once(np.empty((0, 3)), np.empty(0)) == 0.0


def test_surfaces_that_do_not_meet_say_nothing():
    here = RGBDPair("corner", frame(corner()), frame(corner()), None, 0)
    measurements = Measurements(SurfaceMeasurements(here, **LIMITS), None)
    away = se_exp((0.0, np.pi, 0.0, 0.0, 0.0, 0.0))
    assert measurements.equations(away, SOME) == []
    assert np.isinf(measurements.scale(away))
    found = refine(measurements, away, SOME)
    np.testing.assert_array_equal(found.T_target_source, away)
    assert len(found.uncertainty(np.random.default_rng(0).normal(size=(50, 3))).unobservable) == 6
