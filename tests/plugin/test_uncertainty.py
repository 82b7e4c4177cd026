"""Covariance models: the published numbers, monotonicity, positive definiteness and equivariance."""

import math

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import special_ortho_group

from adagmm_o3d.uncertainty import (
    KinectUncertainty,
    estimate_kinect_covariances,
    estimate_kinect_surface_covariances,
    estimate_nguyen_covariances,
    estimate_surface_covariances,
    mark_outliers,
    nguyen_axial_sigma,
    nguyen_lateral_sigma_px,
)

depths = st.floats(0.1, 20.0)
angles = st.floats(0.0, math.pi / 2)
seeds = st.integers(0, 2**32 - 1)


def on_axis(depth, angle):
    """A point on the optical axis whose normal makes that angle with the ray, as (1, 3) arrays."""
    return np.array([[0.0, 0.0, depth]]), np.array([[math.sin(angle), 0.0, -math.cos(angle)]])


def view(seed, count=50):
    """Random points in front of a camera and random normals."""
    rng = np.random.default_rng(seed)
    points = np.column_stack([rng.uniform(-2, 2, (count, 2)), rng.uniform(0.4, 5, count)])
    return points, rng.normal(size=(count, 3))


def roll(angle):
    """A turn about the optical axis, the one rotation under which a depth camera sees the same depths."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


MODELS = {
    "kinect": estimate_kinect_covariances,
    "nguyen": lambda points, normals: estimate_nguyen_covariances(points, normals, 525.0),
    "kinect-surface": lambda points, normals: estimate_kinect_surface_covariances(points, normals, 525.0),
}
both = pytest.mark.parametrize("estimate", MODELS.values(), ids=MODELS)


# Kinect, Eq. 6


def test_kinect_constants_as_printed():
    points, normals = on_axis(3.0, 0.0)
    assert estimate_kinect_covariances(points, normals)[0, 0, 0] == pytest.approx(math.exp(0.2776 * 3), rel=1e-12)
    points, normals = on_axis(2.0, math.pi / 3)
    expected = math.exp(1.6658 * 0.5 + 0.2776 * 2.0)
    np.testing.assert_allclose(
        estimate_kinect_covariances(points, normals), [expected * np.eye(3)], rtol=1e-12, atol=1e-15
    )


@given(reference=st.floats(1.0, 10.0))
def test_kinect_weights_follow_from_the_reference_uncertainty(reference):
    model = KinectUncertainty.from_reference(reference)
    assert model.uncertainty(math.cos(math.pi / 3), 0.0) == pytest.approx(reference, rel=1e-12)
    assert model.uncertainty(1.0, 3.0) == pytest.approx(reference, rel=1e-12)


def test_the_printed_weights_belong_to_2_3_and_not_to_2_2():
    model = KinectUncertainty.from_reference(2.3)
    assert (round(model.w1, 4), round(model.w2, 4)) == (KinectUncertainty().w1, KinectUncertainty().w2)
    model = KinectUncertainty.from_reference(2.2)
    assert (round(model.w1, 4), round(model.w2, 4)) == (1.5769, 0.2628)


@given(depth=depths, farther=st.floats(0.01, 5.0), angle=angles, steeper=st.floats(0.01, 1.0))
def test_kinect_uncertainty_grows_with_depth_and_with_angle(depth, farther, angle, steeper):
    def u(z, alpha):
        return estimate_kinect_covariances(*on_axis(z, alpha))[0, 0, 0]

    assert u(depth + farther, angle) > u(depth, angle)
    if angle + steeper <= math.pi / 2:
        assert u(depth, angle + steeper) > u(depth, angle)


def test_the_angle_is_that_to_the_ray_and_not_to_the_optical_axis():
    point = np.array([[2.0, 0.0, 2.0]])
    head_on = estimate_kinect_covariances(point, -point)
    np.testing.assert_allclose(head_on, [math.exp(0.2776 * 2.0) * np.eye(3)], rtol=1e-12, atol=0.0)
    facing_the_image_plane = estimate_kinect_covariances(point, [[0.0, 0.0, -1.0]])
    expected = math.exp(1.6658 * (1.0 - math.sqrt(0.5)) + 0.2776 * 2.0)
    np.testing.assert_allclose(facing_the_image_plane, [expected * np.eye(3)], rtol=1e-12, atol=0.0)


# Nguyen et al. 2012


@pytest.mark.parametrize(
    "depth, angle_deg, axial, lateral_px",
    [
        (0.4, 0.0, 0.0012, 0.8),
        (1.4, 45.0, 0.0031, 0.835),
        (2.4, 60.0, 0.0088, 0.87),
        (0.4, 63.0, 0.0012 + 0.0001 / math.sqrt(0.4) * (7.0 / 3.0) ** 2, 0.8 + 0.035 * 7.0 / 3.0),
        (4.0, 75.0, 0.0012 + 0.0019 * 3.6**2 + 0.0001 / 2.0 * 25.0, 0.975),
    ],
)
def test_nguyen_standard_deviations_by_hand(depth, angle_deg, axial, lateral_px):
    angle = math.radians(angle_deg)
    assert nguyen_axial_sigma(depth, angle) == pytest.approx(axial, rel=1e-12)
    assert nguyen_lateral_sigma_px(angle) == pytest.approx(lateral_px, rel=1e-12)
    (covariance,) = estimate_nguyen_covariances(*on_axis(depth, angle), (500.0, 400.0))
    lateral = lateral_px * depth
    expected = np.diag([(lateral / 500.0) ** 2, (lateral / 400.0) ** 2, axial**2])
    np.testing.assert_allclose(covariance, expected, rtol=1e-9, atol=1e-20)


@given(depth=st.floats(0.4, 10.0), farther=st.floats(0.0, 5.0), angle=angles, steeper=angles)
def test_nguyen_noise_grows_with_depth_and_with_angle(depth, farther, angle, steeper):
    low, high = sorted([angle, steeper])
    assert nguyen_lateral_sigma_px(high) >= nguyen_lateral_sigma_px(low)
    assert nguyen_axial_sigma(depth, high) >= nguyen_axial_sigma(depth, low)
    if high <= math.pi / 3:  # the grazing term falls with √z
        assert nguyen_axial_sigma(depth + farther, angle) >= nguyen_axial_sigma(depth, angle)


def test_nguyen_stays_finite_at_90_degrees():
    covariance = estimate_nguyen_covariances(*on_axis(1.0, math.pi / 2), 525.0)
    np.testing.assert_allclose(
        covariance, estimate_nguyen_covariances(*on_axis(1.0, math.radians(85.0)), 525.0), rtol=1e-9, atol=1e-20
    )


def test_nguyen_is_the_spread_of_back_projected_pixels():
    point, normal = np.array([[0.9, -0.6, 2.0]]), np.array([[0.2, 0.1, -1.0]])
    fx, fy = 520.0, 530.0
    angle = math.acos(abs((point * normal).sum()) / np.linalg.norm(point) / np.linalg.norm(normal))
    rng = np.random.default_rng(0)
    z = 2.0 + nguyen_axial_sigma(2.0, angle) * rng.normal(size=400_000)
    u, v = (rng.normal(size=(2, len(z))) * nguyen_lateral_sigma_px(angle)) + np.array([[0.45 * fx], [-0.3 * fy]])
    samples = np.cov(np.stack([u / fx * z, v / fy * z, z]))
    (covariance,) = estimate_nguyen_covariances(point, normal, (fx, fy))
    np.testing.assert_allclose(covariance, samples, rtol=0.02, atol=0.01 * samples.max())


# Noise and surface


def test_across_the_surface_is_the_noise_and_along_it_also_the_spacing():
    rows, columns = np.indices((30, 30)).reshape(2, -1)
    points = np.column_stack([0.02 * columns - 0.3, 0.02 * rows - 0.3, np.full(900, 1.5)])
    normals = np.tile([0.0, 0.0, -2.0], (900, 1))
    noise = estimate_nguyen_covariances(points, normals, 525.0)
    inside = (rows > 0) & (rows < 29) & (columns > 0) & (columns < 29)
    expected = noise + np.diag([0.02**2, 0.02**2, 0.0])
    covariances = estimate_kinect_surface_covariances(points, normals, 525.0)
    np.testing.assert_allclose(covariances[inside], expected[inside], rtol=1e-9, atol=1e-12)


def test_a_point_alone_has_its_noise():
    point, normal = on_axis(2.0, 0.3)
    np.testing.assert_allclose(
        estimate_kinect_surface_covariances(point, normal, 525.0),
        estimate_nguyen_covariances(point, normal, 525.0),
        rtol=1e-12,
        atol=0.0,
    )


# All sensors


@both
@given(seed=seeds)
def test_sensor_covariances_are_symmetric_and_positive_definite(estimate, seed):
    covariances = estimate(*view(seed))
    np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(covariances).min() > 0.0


@both
@given(seed=seeds, angle=st.floats(-math.pi, math.pi))
def test_rolling_the_camera_rolls_the_covariances(estimate, seed, angle):
    points, normals = view(seed)
    turned = estimate(points @ roll(angle).T, normals @ roll(angle).T)
    expected = roll(angle) @ estimate(points, normals) @ roll(angle).T
    np.testing.assert_allclose(turned, expected, rtol=1e-7, atol=1e-9 * expected.max())


@both
@given(seed=seeds)
def test_neither_the_sign_nor_the_length_of_a_normal_matters(estimate, seed):
    points, normals = view(seed)
    expected = estimate(points, normals)
    np.testing.assert_allclose(estimate(points, -3.0 * normals), expected, rtol=1e-7, atol=1e-9 * expected.max())


@both
def test_sensor_models_take_open3d_vectors_and_float32_and_no_points(estimate):
    points, normals = view(4)
    expected = estimate(points, normals)
    vectors = [o3d.utility.Vector3dVector(a) for a in (points, normals)]
    np.testing.assert_array_equal(estimate(*vectors), expected)
    single = estimate(points.astype(np.float32), normals.astype(np.float32))
    assert single.dtype == np.float64
    np.testing.assert_allclose(single, expected, rtol=1e-3, atol=1e-5 * expected.max())
    assert estimate(np.empty((0, 3)), np.empty((0, 3))).shape == (0, 3, 3)


# Surface neighbourhoods


@pytest.mark.parametrize("dimension", [2, 3])
@given(seed=seeds, epsilon=st.floats(1e-6, 1.0))
def test_surface_covariances_are_thin_along_the_given_normals(dimension, seed, epsilon):
    rng = np.random.default_rng(seed)
    points, normals = rng.normal(size=(2, 30, dimension))
    covariances = estimate_surface_covariances(points, normals, epsilon=epsilon)
    expected = np.tile([epsilon] + [1.0] * (dimension - 1), (30, 1))
    np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
    np.testing.assert_allclose(np.linalg.eigvalsh(covariances), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", covariances, normals), epsilon * normals, rtol=1e-9, atol=1e-13 * np.abs(normals).max()
    )


def test_estimated_normals_are_those_of_open3d():
    rng = np.random.default_rng(2)
    xy = rng.uniform(-1, 1, (500, 2))
    points = np.column_stack([xy, 0.3 * np.sin(3 * xy[:, 0]) + 0.01 * rng.normal(size=500)])
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20), fast_normal_computation=False)
    from_open3d = estimate_surface_covariances(points, cloud.normals)
    np.testing.assert_allclose(estimate_surface_covariances(points), from_open3d, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
@given(seed=seeds)
def test_surface_covariances_turn_with_the_cloud(dimension, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(40, dimension)) * ([1.0, 0.2] if dimension == 2 else [1.0, 0.8, 0.1])
    rotation = special_ortho_group.rvs(dimension, random_state=rng)
    turned = estimate_surface_covariances(points @ rotation.T + 3.0, knn=8)
    expected = rotation @ estimate_surface_covariances(points, knn=8) @ rotation.T
    # a neighbourhood may be nearly round, its normal then hangs on rounding: almost all must agree
    agree = np.abs(turned - expected).max(axis=(1, 2)) < 1e-6
    assert agree.mean() > 0.9


def test_surface_of_a_plane_and_of_a_curve():
    rng = np.random.default_rng(8)
    plane = np.column_stack([rng.uniform(size=(200, 2)), np.full(200, 2.0)])
    np.testing.assert_allclose(
        estimate_surface_covariances(plane), np.tile(np.diag([1.0, 1.0, 1e-3]), (200, 1, 1)), rtol=0.0, atol=1e-12
    )
    line = np.column_stack([np.full(50, -1.0), rng.uniform(size=50)])
    np.testing.assert_allclose(
        estimate_surface_covariances(line, epsilon=0.01),
        np.tile(np.diag([0.01, 1.0]), (50, 1, 1)),
        rtol=0.0,
        atol=1e-12,
    )


@pytest.mark.parametrize(
    "points",
    [np.outer(np.arange(30.0), [1.0, 2.0, -1.0]), np.ones((30, 3)), np.ones((30, 2))],
    ids=["on a line", "coinciding", "coinciding in 2D"],
)
def test_neighbourhoods_without_a_normal_give_the_identity(points):
    identity = np.tile(np.eye(points.shape[1]), (30, 1, 1))
    np.testing.assert_array_equal(estimate_surface_covariances(points), identity)


def test_surface_covariances_do_not_depend_on_the_chunk(monkeypatch):
    points = np.random.default_rng(6).normal(size=(101, 3))
    whole = estimate_surface_covariances(points)
    monkeypatch.setattr("adagmm_o3d.uncertainty.surface.CHUNK", 10)
    np.testing.assert_array_equal(estimate_surface_covariances(points), whole)


def test_points_given_again_have_the_covariances_of_one():
    points = np.random.default_rng(4).normal(size=(300, 3)) * [1.0, 1.0, 0.05]
    again = estimate_surface_covariances(np.repeat(points, 30, axis=0))
    np.testing.assert_array_equal(again, np.repeat(estimate_surface_covariances(points), 30, axis=0))


def test_fewer_points_than_neighbours_use_them_all():
    points = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(
        estimate_surface_covariances(points), np.tile(np.diag([1.0, 1.0, 1e-3]), (4, 1, 1)), rtol=0.0, atol=1e-12
    )


# Outliers


@given(seed=seeds, scale=st.floats(1.0, 1e8))
def test_marked_outliers_are_enlarged_and_the_rest_is_untouched(seed, scale):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(20, 3, 3))
    covariances, mask = root @ root.transpose(0, 2, 1), rng.random(20) < 0.4
    before = covariances.copy()
    marked = mark_outliers(covariances, mask, scale=scale)
    np.testing.assert_array_equal(covariances, before)
    np.testing.assert_array_equal(marked[~mask], covariances[~mask])
    np.testing.assert_allclose(marked[mask], scale * covariances[mask], rtol=1e-15, atol=0.0)


def test_marking_defaults_to_the_factor_in_the_papers_data_and_lets_non_finite_ones_pass():
    covariances = np.array([np.eye(2), np.full((2, 2), np.nan), 2.0 * np.eye(2)])
    marked = mark_outliers(covariances, np.array([True, False, False]))
    np.testing.assert_array_equal(marked, [1e6 * np.eye(2), np.full((2, 2), np.nan), 2.0 * np.eye(2)])
