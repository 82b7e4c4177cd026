"""Clouds at the edge of what can be registered: the right answer or an honest refusal, never NaN, never a warning.

NumPy's warnings are errors here; a result that is wrong must say that it is not to be trusted.
"""

from typing import get_args

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy, move

from adagmm_o3d import (
    DegenerateError,
    InputError,
    TransformationEstimationForAdaptiveGMM,
    mark_outliers,
    register_points,
    registration_adaptive_gmm,
)
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.options import SigmaRuleName
from adagmm_o3d.trust.observability import generalised_eigen

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning", "error::DeprecationWarning")
rules = pytest.mark.parametrize("rule", get_args(SigmaRuleName))
N = 300
TEN = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=10)


def with_rule(rule, **kwargs):
    return TransformationEstimationForAdaptiveGMM(sigma_rule=rule, **kwargs)


def assert_finite(result):
    for name in ("transformation", "sigmas", "energies", "transformations", "row_weights", "overlap", "sigma"):
        assert np.isfinite(getattr(result, name)).all(), name
    if result.pose_covariance is not None:
        assert np.isfinite(result.pose_covariance).all()
    assert all(np.isfinite(direction).all() for direction in result.unobservable)
    rotation = result.transformation[:-1, :-1]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(len(rotation)), rtol=0, atol=1e-9)


def assert_right_or_doubted(result, T, *, angle_deg=2.0, translation=0.05):
    assert_finite(result)
    errors = pose_errors(T, result.transformation)
    right = errors.rotation_deg < angle_deg and errors.translation < translation
    assert right or not result.trustworthy


@pytest.fixture(scope="module")
def cloud():
    rng = np.random.default_rng(0)
    points = bumpy(rng, N, 3)
    return points, random_pose(rng, 3, angle=0.3, distance=0.3)


@rules
@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1e6, 1e12])
def test_any_unit_of_length(cloud, rule, unit):
    points, T = cloud
    scaled = T.copy()
    scaled[:3, 3] *= unit
    result = register_points(unit * points, move(unit * points, scaled), estimation_method=with_rule(rule))
    result.transformation[:3, 3] /= unit
    assert_right_or_doubted(result, T)
    assert np.isfinite(result.sigma) and result.sigma > 0.0


@rules
def test_far_from_the_origin(cloud, rule):
    points, T = cloud
    offset = np.array([1e6, -2e6, 3e5])
    far_target = move(points, T) - 3.0 * offset
    result = register_points(points + offset, far_target, estimation_method=with_rule(rule))
    assert_finite(result)
    distance = np.linalg.norm(move(points + offset, result.transformation) - far_target, axis=1).max()
    assert distance < 0.02 or not result.trustworthy


def test_far_from_the_origin_as_clouds(cloud):
    points, T = cloud
    offset = np.array([1e6, -2e6, 3e5])
    clouds = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (points + offset, move(points, T) - offset)
    ]
    result = registration_adaptive_gmm(*clouds, 0.02)
    assert result.fitness == 1.0


@rules
def test_identical_clouds(cloud, rule):
    points, _ = cloud
    assert_right_or_doubted(
        register_points(points, points, estimation_method=with_rule(rule)), np.eye(4), angle_deg=0.01, translation=1e-4
    )


@rules
def test_one_plane(cloud, rule):
    points, T = cloud
    flat = points * [1.0, 1.0, 0.0]
    assert_right_or_doubted(register_points(flat, move(flat, T), estimation_method=with_rule(rule)), T)


def outline(step):
    """The edges of a rectangle of 10 by 5, flat in space."""
    x, y = np.arange(0.0, 10.0, step), np.arange(0.0, 5.0, step)
    edges = [(x, 0.0 * x), (x, 0.0 * x + 5.0), (0.0 * y, y), (0.0 * y + 10.0, y)]
    return np.concatenate([np.stack([u, v, 0.0 * u], axis=1) for u, v in edges])


@pytest.mark.parametrize("step", [0.02, 0.05, 0.1, 0.5])
def test_a_flat_outline_registered_to_itself(step):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(outline(step)))
    assert_right_or_doubted(registration_adaptive_gmm(cloud, cloud, 0.1).details, np.eye(4))


def test_what_no_point_speaks_of_is_divided_by_almost_nothing():
    values, motions = generalised_eigen(np.diag([0.0, 2.0, 3.0]), np.diag([0.0, 1.0, 2.0]))
    np.testing.assert_allclose(values, [0.0, 1.5, 2.0], rtol=1e-9, atol=1e-9)
    assert np.isfinite(motions).all()
    assert generalised_eigen(np.diag([1.0, 2.0]), np.diag([0.0, 1.0]))[0][1] > 1e9
    np.testing.assert_array_equal(generalised_eigen(np.zeros((2, 2)), np.zeros((2, 2)))[0], 0.0)


@rules
def test_a_line_in_the_plane(rule):
    line = np.linspace(0.0, 1.0, 50)[:, None] * np.array([1.0, 2.0])
    T = random_pose(np.random.default_rng(1), 2, angle=0.2, distance=0.1)
    assert_right_or_doubted(register_points(line, move(line, T), estimation_method=with_rule(rule)), T)


@rules
@pytest.mark.parametrize("gap", [1e2, 1e6, 1e10, 1e30, 1e200, 1e307])
def test_a_start_where_the_clouds_do_not_overlap(cloud, rule, gap):
    points, T = cloud
    init = np.eye(4)
    init[0, 3] = gap
    try:
        result = register_points(points, move(points, T), init=init, estimation_method=with_rule(rule))
    except InputError as error:
        assert str(error).startswith("init: ")
    else:
        assert_right_or_doubted(result, T)


@rules
def test_clouds_far_apart_and_told_to_start_there(cloud, rule):
    points, T = cloud
    far = move(points, T) + 1e4
    shifted = T.copy()
    shifted[:3, 3] += 1e4
    result = register_points(points, far, estimation_method=with_rule(rule, start="init"))
    assert_right_or_doubted(result, shifted)


@pytest.mark.slow
@rules
def test_three_points_against_very_many(cloud, rule):
    _, T = cloud
    many = bumpy(np.random.default_rng(2), 100_000, 3)
    for source, target in ((many[:3], move(many, T)), (many, move(many[:3], T))):
        result = register_points(source, target, estimation_method=with_rule(rule))
        assert_finite(result)


@pytest.mark.parametrize("dimension", [2, 3])
def test_one_point_against_very_many(dimension):
    many = bumpy(np.random.default_rng(2), 100_000, dimension)
    for clouds, name in (((many[:1], many), "source"), ((many, many[:1]), "target")):
        with pytest.raises(DegenerateError, match=rf"^{name}\.points: 1 point cannot fix a pose"):
            register_points(*clouds)


@pytest.mark.slow
def test_a_million_points(cloud):
    _, T = cloud
    rng = np.random.default_rng(2)
    many, few = bumpy(rng, 1_000_000, 3), bumpy(rng, 300, 3)
    result = register_points(many, move(few, T), init=T, criteria=TEN)
    assert_right_or_doubted(result, T)
    assert result.row_weights.shape == (1_000_000,)


def test_three_points_against_themselves(cloud):
    points, T = cloud
    result = register_points(points[:3], move(points[:3], T))
    assert_right_or_doubted(result, T)


@rules
@pytest.mark.parametrize("scale", [1e-307, 1e-30, 1e30, 1e307])
@pytest.mark.parametrize("isotropic", [True, False])
def test_covariances_of_any_size(cloud, rule, scale, isotropic):
    points, T = cloud
    factors = np.random.default_rng(3).normal(size=(N, 3, 3))
    shape = np.eye(3) if isotropic else 0.2 * factors @ factors.transpose(0, 2, 1) + 0.5 * np.eye(3)
    covariances = scale * np.broadcast_to(shape, (N, 3, 3))
    turned = T[:3, :3] @ covariances @ T[:3, :3].T
    result = register_points(points, move(points, T), covariances, turned, estimation_method=with_rule(rule))
    assert_right_or_doubted(result, T)


@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("scale", [5e-324, 1e-320, 1e-309])
def test_covariances_too_small_for_digits_are_none(cloud, scale, isotropic):
    """Some of them: as zeros, given what is typical. All of them: refused as zeros are."""
    points, T = cloud
    covariances = np.tile(np.eye(3) if isotropic else np.diag([1.0, 1.0, 0.01]), (N, 1, 1))
    small = covariances.copy()
    small[:5] *= scale
    result = register_points(points, move(points, T), small, covariances)
    assert result.regularised_source == 5
    zeros = np.where(np.arange(N)[:, None, None] < 5, 0.0, covariances)
    same = register_points(points, move(points, T), zeros, covariances)
    assert np.array_equal(result.transformation, same.transformation)
    with pytest.raises(InputError, match=f"source.covariances: all {N} are zero"):
        register_points(points, move(points, T), scale * covariances, covariances)


@rules
@pytest.mark.parametrize("factor", [1e-300, 1e-12, 1e12, 1e300])
def test_covariances_of_very_different_sizes(cloud, rule, factor):
    points, T = cloud
    covariances = np.tile(np.eye(3), (N, 1, 1))
    covariances[::2] *= factor
    result = register_points(points, move(points, T), covariances, covariances, estimation_method=with_rule(rule))
    assert_right_or_doubted(result, T)


@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    ("large", "small"), [(1e300, 1e-300), (1e200, 1e-200), (1e304, 1e-307), (1e300, 1.0), (1.0, 1e-300)]
)
def test_covariances_of_one_cloud_at_both_ends_of_all_numbers(large, small, dimension, isotropic):
    """As points that are flagged and points that are not: neither a wrong pose nor NumPy's LinAlgError."""
    rng = np.random.default_rng(3)
    points, T = bumpy(rng, N, dimension), random_pose(rng, dimension, angle=0.2, distance=0.2)
    covariances = np.tile(np.eye(dimension), (N, 1, 1))
    if not isotropic:
        factors = rng.normal(size=(N, dimension, dimension))
        covariances += factors @ factors.transpose(0, 2, 1)
    covariances[: N // 2] *= large
    covariances[N // 2 :] *= small
    rotation = T[:dimension, :dimension]
    result = register_points(points, move(points, T), covariances, rotation @ covariances @ rotation.T)
    assert_finite(result)
    errors = pose_errors(T, result.transformation)
    assert errors.rotation_deg < 2.0 and errors.translation < 0.05


@rules
@pytest.mark.parametrize("thickness", [1e-3, 1e-6, 1e-9, 1e-11])
def test_covariances_as_thin_as_paper(cloud, rule, thickness):
    points, T = cloud
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    covariances = np.eye(3) - (1.0 - thickness) * normals[:, :, None] * normals[:, None, :]
    turned = T[:3, :3] @ covariances @ T[:3, :3].T
    result = register_points(points, move(points, T), covariances, turned, estimation_method=with_rule(rule))
    assert_right_or_doubted(result, T)


@rules
def test_nothing_but_outliers_on_one_side(cloud, rule):
    points, T = cloud
    flagged = mark_outliers(np.tile(np.eye(3), (N, 1, 1)), np.ones(N, bool))
    result = register_points(points, move(points, T), flagged, None, estimation_method=with_rule(rule))
    assert_finite(result)
    assert not result.trustworthy


@rules
def test_nothing_but_outliers_on_both_sides_is_a_common_factor(cloud, rule):
    points, T = cloud
    flagged = mark_outliers(np.tile(np.eye(3), (N, 1, 1)), np.ones(N, bool))
    result = register_points(points, move(points, T), flagged, flagged, estimation_method=with_rule(rule))
    assert_right_or_doubted(result, T)


@rules
@pytest.mark.parametrize("distance", [1e3, 1e6, 1e9])
def test_a_far_point_is_left_out(cloud, rule, distance):
    points, T = cloud
    far = np.vstack([points, [[distance, 0.0, 0.0]]])
    result = register_points(far, move(points, T), estimation_method=with_rule(rule))
    alone = register_points(points, move(points, T), estimation_method=with_rule(rule))
    assert (result.dropped_source, result.dropped_target) == (1, 0)
    assert result.row_weights[-1] == 0.0
    np.testing.assert_array_equal(result.transformation, alone.transformation)
    assert result.warnings == alone.warnings


def test_zeros_for_no_return_far_from_the_scene_are_left_out(cloud):
    points, T = cloud
    there = points + 500.0
    here = move(there, T)
    zeros = np.zeros((9, 3))
    result = register_points(np.vstack([zeros, there]), np.vstack([here, zeros]))
    assert (result.dropped_source, result.dropped_target) == (9, 9)
    np.testing.assert_allclose(result.transformation, register_points(there, here).transformation, atol=1e-9)


@pytest.mark.parametrize("make", [lambda rng: rng.normal(size=(N, 3)), lambda rng: rng.standard_t(2, size=(3000, 3))])
def test_what_thins_out_with_distance_is_not_far(make):
    points = make(np.random.default_rng(8))
    assert register_points(points, move(points, random_pose(np.random.default_rng(9), 3))).dropped_source == 0


@rules
def test_a_far_point_that_is_flagged_does_no_harm(cloud, rule):
    points, T = cloud
    far = np.vstack([points, [[1e6, 0.0, 0.0]]])
    covariances = mark_outliers(np.tile(np.eye(3), (N + 1, 1, 1)), np.arange(N + 1) == N)
    result = register_points(far, move(points, T), covariances, None, estimation_method=with_rule(rule))
    assert_right_or_doubted(result, T)


@rules
@pytest.mark.parametrize("factor", [1e-9, 1e-4])
def test_clouds_in_different_units_are_refused(cloud, rule, factor):
    points, T = cloud
    for clouds, name in (((factor * points, move(points, T)), "source"), ((points, factor * points), "target")):
        with pytest.raises(InputError, match=rf"^{name}\.points: 90% lie within .*; check the units"):
            register_points(*clouds, estimation_method=with_rule(rule))


@rules
def test_points_repeated_in_one_place(cloud, rule):
    points, T = cloud
    repeated = np.vstack([points, np.repeat(points[:1], N, axis=0)])
    assert_right_or_doubted(register_points(repeated, move(repeated, T), estimation_method=with_rule(rule)), T)


@pytest.mark.parametrize("places", [400, 2000])
@pytest.mark.parametrize("times", [5, 30])
def test_points_given_again_and_again(places, times):
    """They make a dense cloud of few places: there is no scale below that of these."""
    rng = np.random.default_rng(6)
    points, T = bumpy(rng, places, 3), random_pose(rng, 3, angle=0.2, distance=0.2)
    source, target = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (points, move(points, T)))
    again = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.repeat(points, times, axis=0)))
    result = registration_adaptive_gmm(again, target, 0.1, np.eye(4)).details
    assert result.warnings == registration_adaptive_gmm(source, target, 0.1, np.eye(4)).details.warnings == ()
    assert np.isfinite(result.pose_covariance).all()
    errors = pose_errors(T, result.transformation)
    assert errors.rotation_deg < 0.05 and errors.translation < 1e-3


@pytest.mark.parametrize("make", [lambda rng: rng.normal(size=(N, 3)), lambda rng: rng.uniform(size=(N, 3))])
def test_unrelated_clouds_give_something_finite(cloud, make):
    points, _ = cloud
    assert_finite(register_points(points, make(np.random.default_rng(4))))


@pytest.mark.parametrize("dimension", [2, 3])
def test_as_few_points_as_possible_everywhere(dimension):
    rng = np.random.default_rng(dimension)
    for _ in range(20):
        points = rng.normal(size=(rng.integers(3, 6), dimension))
        T = random_pose(rng, dimension, angle=rng.uniform(0.01, 3.0), distance=0.5)
        for init in (None, "global"):
            assert_finite(register_points(points, move(points, T), init=init))
