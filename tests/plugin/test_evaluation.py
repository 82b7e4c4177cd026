"""Errors against a known pose, near 0° and 180° too; fit and information matrix against Open3D's."""

import math

import numpy as np
import open3d as o3d
import pytest
import reference
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.stats import special_ortho_group

from adagmm_o3d.evaluation import (
    evaluate_registration,
    information_matrix,
    overlap_ratio,
    pose_errors,
    rotation_error_deg,
    rotation_error_frobenius,
    translation_error,
)

seeds = st.integers(0, 2**32 - 1)
dimensions = pytest.mark.parametrize("dimension", [2, 3])


def random_pose(rng, dimension):
    pose = np.eye(dimension + 1)
    pose[:-1, :-1] = special_ortho_group.rvs(dimension, random_state=rng)
    pose[:-1, -1] = rng.normal(size=dimension)
    return pose


def turned_by(angle, dimension, rng):
    """A pose that turns by exactly that angle, about a random axis in space."""
    axis = np.array([1.0]) if dimension == 2 else rng.normal(size=3)
    delta = np.concatenate([angle * axis / np.linalg.norm(axis), np.zeros(dimension)])
    pose = np.eye(dimension + 1)
    pose[:-1, :-1], _ = reference.apply_tangent(delta, np.eye(dimension), np.zeros(dimension))
    return pose


def clouds(seed, dimension, count=60):
    rng = np.random.default_rng(seed)
    source, pose = rng.normal(size=(count, dimension)), random_pose(rng, dimension)
    moved = source @ pose[:-1, :-1].T + pose[:-1, -1]
    target = np.concatenate([moved[: count // 2] + 0.1 * rng.normal(size=(count // 2, dimension)), moved[:1] + 9.0])
    return source, rng.permutation(target), pose


def as_open3d(points):
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


# Against a known pose


@pytest.mark.slow
@dimensions
@given(seed=seeds, exponent=st.floats(-9.0, 0.0), near=st.sampled_from(["0", "180"]))
def test_rotation_error_is_the_angle_also_near_0_and_180_degrees(dimension, seed, exponent, near):
    rng = np.random.default_rng(seed)
    angle = 10.0**exponent if near == "0" else math.pi - 10.0**exponent
    T_true = random_pose(rng, dimension)
    T_est = T_true @ turned_by(angle, dimension, rng)
    assert rotation_error_deg(T_true, T_est) == pytest.approx(math.degrees(angle), rel=1e-9, abs=1e-13)
    frobenius = 2.0 * math.sqrt(2.0) * math.sin(angle / 2.0)
    assert rotation_error_frobenius(T_true, T_est) == pytest.approx(frobenius, rel=1e-9, abs=1e-14)


@dimensions
@given(seed=seeds)
def test_errors_are_symmetric_and_do_not_depend_on_the_frame(dimension, seed):
    rng = np.random.default_rng(seed)
    a, b, frame = (random_pose(rng, dimension) for _ in range(3))
    for error in (rotation_error_deg, rotation_error_frobenius, translation_error):
        assert error(a, b) == pytest.approx(error(b, a), rel=1e-9, abs=1e-12)
        assert error(frame @ a, frame @ b) == pytest.approx(error(a, b), rel=1e-9, abs=1e-12)
    assert rotation_error_deg(a @ frame, b @ frame) == pytest.approx(rotation_error_deg(a, b), rel=1e-9, abs=1e-12)


@dimensions
@given(seed=seeds)
def test_rotation_error_obeys_the_triangle_inequality(dimension, seed):
    rng = np.random.default_rng(seed)
    a, b, c = (random_pose(rng, dimension) for _ in range(3))
    for error in (rotation_error_deg, rotation_error_frobenius):
        assert error(a, c) <= error(a, b) + error(b, c) + 1e-9


def test_errors_by_hand():
    T_true, T_est = np.eye(4), np.eye(4)
    T_est[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    T_est[:3, 3] = [0.3, 0.0, -0.4]
    errors = pose_errors(T_true, T_est)
    assert errors.rotation_deg == pytest.approx(90.0, rel=1e-14)
    assert errors.rotation_frobenius == pytest.approx(2.0, rel=1e-14)
    assert errors.translation == pytest.approx(0.5, rel=1e-14)


@pytest.mark.parametrize("digits", [4, 3])
def test_a_rotation_rounded_to_a_few_digits_is_no_error(digits):
    for seed in range(100):
        pose = random_pose(np.random.default_rng(seed), 3)
        rounded = np.round(pose, digits)
        assert rotation_error_deg(rounded, rounded) == pytest.approx(0.0, abs=1e-13)
        assert rotation_error_deg(pose, rounded) < 100.0 * 10.0**-digits


# Between two clouds


@dimensions
@given(seed=seeds, distance=st.floats(0.02, 3.0))
def test_overlap_is_the_share_of_points_with_a_neighbour(dimension, seed, distance):
    source, target, pose = clouds(seed, dimension)
    nearest, _ = cKDTree(target).query(source @ pose[:-1, :-1].T + pose[:-1, -1])
    assume(np.abs(nearest - distance).min() > 1e-9)
    assert overlap_ratio(source, target, pose, distance) == pytest.approx(np.mean(nearest < distance), rel=1e-15)


@dimensions
@given(seed=seeds)
def test_overlap_does_not_depend_on_the_frame_and_grows_with_the_distance(dimension, seed):
    source, target, pose = clouds(seed, dimension)
    frame = random_pose(np.random.default_rng(seed + 1), dimension)
    moved_target = target @ frame[:-1, :-1].T + frame[:-1, -1]
    shares = [overlap_ratio(source, target, pose, distance) for distance in (0.05, 0.1, 0.2, 0.4)]
    assert shares == sorted(shares)
    assert shares == [overlap_ratio(source, moved_target, frame @ pose, d) for d in (0.05, 0.1, 0.2, 0.4)]


def test_overlap_of_a_cloud_with_itself():
    points = np.random.default_rng(0).normal(size=(30, 2))
    assert overlap_ratio(points, points, np.eye(3), 1e-12) == 1.0
    assert overlap_ratio(points, points + 100.0, np.eye(3), 1.0) == 0.0


@given(seed=seeds, distance=st.floats(0.02, 3.0))
def test_fit_is_that_of_open3d(seed, distance):
    source, target, pose = clouds(seed, 3)
    ours = evaluate_registration(source, target, distance, pose)
    theirs = o3d.pipelines.registration.evaluate_registration(as_open3d(source), as_open3d(target), distance, pose)
    assert ours.fitness == pytest.approx(theirs.fitness, rel=1e-15)
    assert ours.inlier_rmse == pytest.approx(theirs.inlier_rmse, rel=1e-9, abs=1e-15)
    correspondences = np.asarray(theirs.correspondence_set)
    np.testing.assert_array_equal(ours.correspondence_set, correspondences[np.argsort(correspondences[:, 0])])


def test_a_pair_at_exactly_the_distance_does_not_count_as_in_open3d():
    source, target = np.zeros((1, 3)), np.array([[0.25, 0.0, 0.0]])
    theirs = o3d.pipelines.registration.evaluate_registration(as_open3d(source), as_open3d(target), 0.25, np.eye(4))
    ours = evaluate_registration(source, target, 0.25, np.eye(4))
    assert ours.fitness == theirs.fitness == overlap_ratio(source, target, np.eye(4), 0.25) == 0.0
    assert ours.inlier_rmse == 0.0
    assert ours.correspondence_set.shape == (0, 2)


@given(seed=seeds, distance=st.floats(0.02, 3.0))
def test_information_matrix_is_that_of_open3d(seed, distance):
    source, target, pose = clouds(seed, 3)
    theirs = o3d.pipelines.registration.get_information_matrix_from_point_clouds(
        as_open3d(source), as_open3d(target), distance, pose
    )
    ours = information_matrix(source, target, distance, pose)
    np.testing.assert_allclose(ours, theirs, rtol=1e-10, atol=1e-10 * max(1.0, np.abs(theirs).max()))


@dimensions
def test_information_is_the_curvature_of_the_squared_motion_of_the_target_points(dimension):
    source, target, pose = clouds(3, dimension)
    fit = evaluate_registration(source, target, 0.5, pose)
    q = target[fit.correspondence_set[:, 1]]
    assert len(q) > 10
    information = information_matrix(source, target, 0.5, pose)
    rng = np.random.default_rng(1)
    for _ in range(10):
        delta = 1e-5 * rng.normal(size=len(information))
        rotation, translation = reference.apply_tangent(delta, np.eye(dimension), np.zeros(dimension))
        moved = ((q @ rotation.T + translation - q) ** 2).sum()
        assert delta @ information @ delta == pytest.approx(moved, rel=1e-3, abs=0.0)


def test_information_without_correspondences_is_zero():
    np.testing.assert_array_equal(
        information_matrix(np.zeros((4, 2)), np.ones((4, 2)), 0.5, np.eye(3)), np.zeros((3, 3))
    )
