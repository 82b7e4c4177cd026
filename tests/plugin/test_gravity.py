"""Registration of upright clouds: a turn about gravity and a shift, and nothing else, through every door."""

import math

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy, move

from adagmm_bench.pairs.lidar_scene import scan_pair
from adagmm_o3d import TransformationEstimationForAdaptiveGMM, estimate_surface_covariances, register_points
from adagmm_o3d import registration_adaptive_gmm as registration
from adagmm_o3d.em.m_step import turned_about
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.kernels.update import call_m_step
from adagmm_o3d.lie import se_exp
from adagmm_o3d.result import PoseUncertainty
from adagmm_o3d.trust.upright import held_by_gravity

AXES = [(0.0, 0.0, 1.0), (0.0, -9.81, 0.0), (0.3, -0.5, 0.8)]


def unit(axis):
    return np.array(axis) / np.linalg.norm(axis)


def upright_pose(axis, angle, shift):
    return se_exp(np.concatenate([angle * unit(axis), np.zeros(3)])) + np.pad(
        np.array(shift)[:, None], ((0, 1), (3, 0))
    )


def upright(axis):
    return TransformationEstimationForAdaptiveGMM(gravity=axis)


def tilt(T, axis):
    """By how much a pose tilts gravity [rad]."""
    return float(np.linalg.norm(np.cross(T[:3, :3] @ unit(axis), unit(axis))))


def pair(axis, count, *, tilted=0.0, seed=0):
    """Two samplings of one shape, a turn about the axis and a shift apart, the source tilted by so many radians."""
    rng = np.random.default_rng(seed)
    T = upright_pose(axis, 0.5, (0.2, -0.1, 0.15))
    points = bumpy(rng, 2 * count, 3) + 0.003 * rng.normal(size=(2 * count, 3))
    across = unit(np.cross(axis, (1.0, 0.2, 0.1)))
    lean = se_exp(np.concatenate([tilted * across, np.zeros(3)]))
    source = move(points[:count], np.linalg.inv(T)) @ lean[:3, :3].T
    return source, points[count:], T


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("count", [700, 3000, 15_000])
@pytest.mark.parametrize("init", [None, "global"])
def test_only_the_turn_about_gravity_is_found(axis, count, init):
    source, target, T = pair(axis, count)
    result = register_points(source, target, init=init, estimation_method=upright(axis))
    errors = pose_errors(T, result.transformation)
    assert errors.rotation_deg < (0.8 if count < 1000 else 0.5) and errors.translation < 0.01
    for pose in result.transformations:
        assert tilt(pose, axis) < 1e-7


@pytest.mark.parametrize("count", [700, 3000])
def test_what_tilts_a_cloud_does_not_tilt_the_pose(count):
    source, target, T = pair((0.0, 0.0, 1.0), count, tilted=0.03)
    free = register_points(source, target)
    held = register_points(source, target, estimation_method=upright((0.0, 0.0, 1.0)))
    assert tilt(free.transformation, (0.0, 0.0, 1.0)) > 0.02 and tilt(held.transformation, (0.0, 0.0, 1.0)) < 1e-7
    assert pose_errors(T, held.transformation).rotation_deg < 1.0


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("tilted, said", [(0.0, False), (0.02, False), (0.12, True), (0.25, True)])
def test_clouds_that_are_tilted_against_each_other_are_said_to_be(axis, tilted, said):
    """They went unsaid, with a belief of nearly one."""
    source, target, _ = pair(axis, 2000, tilted=tilted)
    for clouds in ((source, target), (target, source)):
        warnings = register_points(*clouds, estimation_method=upright(axis)).warnings
        assert any("tilted by" in warning for warning in warnings) == said, warnings


def test_a_tensor_is_a_direction():
    assert upright(o3d.core.Tensor([0.0, 0.0, 2.0])).gravity == (0.0, 0.0, 1.0)


def test_an_axis_that_is_not_gravity_is_said_too():
    source, target, _ = pair((0.0, 0.0, 1.0), 2000)
    near = move(source, upright_pose((0.0, 0.0, 1.0), 0.3, (0.2, -0.1, 0.15)))
    for cloud, said in ((near, "tilted by 1"), (source, "")):  # the second is so far off that it is no pose at all
        warnings = register_points(cloud, target, estimation_method=upright((0.0, 1.0, 0.0))).warnings
        assert any(said in warning for warning in warnings)


def test_every_door_keeps_gravity():
    axis = (0.0, 0.0, 1.0)
    source, target, T = pair(axis, 2000)
    covariances = [estimate_surface_covariances(points) for points in (source, target)]
    expected = register_points(source, target, *covariances, estimation_method=upright(axis)).transformation
    legacy = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
    tensor = [o3d.t.geometry.PointCloud(o3d.core.Tensor(points)) for points in (source, target)]
    for found in (
        registration(*legacy, 0.1, np.eye(4), upright(axis)).transformation,
        registration(*tensor, 0.1, np.eye(4), upright(axis)).transformation.numpy(),
    ):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    assert pose_errors(T, expected).rotation_deg < 0.5 and tilt(expected, axis) < 1e-7


def test_level_scans_are_registered_level():
    source, target, T = scan_pair(0, 1.0, 8.0)
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
    result = registration(*clouds, 0.5, np.eye(4), upright((0, 0, 1)))
    errors = pose_errors(T, result.transformation)
    assert errors.rotation_deg < 0.03 and errors.translation < 0.03
    assert tilt(result.transformation, (0, 0, 1)) < 1e-7


def test_a_start_that_keeps_gravity_is_refined_and_one_that_tilts_it_refused():
    axis = (0.0, 0.0, 1.0)
    source, target, T = pair(axis, 800)
    start = upright_pose(axis, 0.4, (0.1, -0.1, 0.1))
    rounded = np.round(start, 3)
    found = register_points(source, target, init=rounded, estimation_method=upright(axis))
    assert pose_errors(T, found.transformation).rotation_deg < 0.5 and tilt(found.transformation, axis) < 1e-7
    leaning = start @ se_exp(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(InputError, match=r"init: expected a turn about gravity .* tilts it 5\.7"):
        register_points(source, target, init=leaning, estimation_method=upright(axis))


@pytest.mark.parametrize("rule", ["annealed", "nearest"])
def test_the_papers_rules_keep_gravity_too(rule):
    axis = (0.0, 0.0, 1.0)
    source, target, _ = pair(axis, 500)
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule, gravity=axis)
    result = register_points(source, target, estimation_method=method)
    assert max(tilt(pose, axis) for pose in result.transformations) < 1e-7


def test_nothing_is_unknown_of_what_gravity_holds():
    axis = (0.3, -0.5, 0.8)
    source, target, _ = pair(axis, 2000)
    result = register_points(source, target, estimation_method=upright(axis))
    turns = result.pose_covariance[:3, :3]
    across = np.linalg.svd(unit(axis)[None])[2][1:]
    assert np.abs(across @ turns).max() < 1e-12 * np.trace(turns)
    assert unit(axis) @ turns @ unit(axis) > 0.0


def test_the_covariance_is_that_on_condition_of_no_tilt():
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(6, 6))
    covariance = factor @ factor.T
    free = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    held = held_by_gravity(PoseUncertainty(covariance, (free, free[[1, 2, 3, 0, 4, 5]])), np.array([0.0, 0.0, 1.0]))
    # the inverse of a Gaussian's block of information is its conditional covariance
    expected = np.linalg.inv(np.linalg.inv(covariance)[2:, 2:])
    np.testing.assert_allclose(held.covariance[2:, 2:], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(held.covariance[:2], 0.0)
    assert len(held.unobservable) == 1 and held.unobservable[0][3] == 1.0


def test_the_step_is_the_least_one_with_a_turn_about_the_axis():
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(6, 6))
    hessian, gradient, axis = factor @ factor.T, rng.normal(size=6), unit((0.3, -0.5, 0.8))
    total = np.concatenate([hessian[np.triu_indices(6)], gradient, np.ones(3)])
    delta = np.empty(6)
    assert call_m_step(total, False, axis, 1.0, 1e-3, 1.0, delta)[0]
    basis = np.zeros((6, 4))
    basis[:3, 0], basis[3:, 1:] = axis, np.eye(3)
    expected = -basis @ np.linalg.solve(basis.T @ hessian @ basis, basis.T @ gradient)
    np.testing.assert_allclose(delta, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_turn_about_an_axis_is_no_farther_than_any_other(seed):
    rng = np.random.default_rng(seed)
    axis, pose = unit(rng.normal(size=3)), random_pose(rng, 3, angle=2.0, distance=1.0)
    found = turned_about(axis, pose)
    np.testing.assert_allclose(found[:3, :3] @ axis, axis, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found[:3, 3], pose[:3, 3])
    angles = np.linspace(-math.pi, math.pi, 721)
    others = [np.trace(upright_pose(axis, a, (0, 0, 0))[:3, :3].T @ pose[:3, :3]) for a in angles]
    assert np.trace(found[:3, :3].T @ pose[:3, :3]) >= max(others) - 1e-12


@pytest.mark.parametrize(
    ("gravity", "error", "message"),
    [
        ((0.0, 0.0, 0.0), InputError, "gravity: expected a direction"),
        ((0.0, 1.0), InputError, "gravity: expected"),
        ((0.0, 0.0, math.nan), InputError, "gravity"),
        ("down", InputTypeError, "gravity"),
    ],
)
def test_what_is_no_direction_is_refused(gravity, error, message):
    with pytest.raises(error, match=message):
        TransformationEstimationForAdaptiveGMM(gravity=gravity)


def test_clouds_in_the_plane_have_no_gravity():
    points = np.random.default_rng(0).normal(size=(50, 2))
    with pytest.raises(InputError, match="gravity: expected None for clouds in the plane"):
        register_points(points, points, estimation_method=upright((0, 0, 1)))
