"""Organised clouds: where nothing was measured a point is NaN, and counts as if it were not there."""

import math

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy, move

from adagmm_o3d import prepare, register_points, registration_adaptive_gmm
from adagmm_o3d.evaluation import evaluate_registration, information_matrix, overlap_ratio
from adagmm_o3d.options import TransformationEstimationForAdaptiveGMM
from adagmm_o3d.uncertainty.surface import stand_in_covariances

legacy_reg, tensor_reg = o3d.pipelines.registration, o3d.t.pipelines.registration
SIZE = 700


def measured(seed):
    """(SIZE,) bool: two in three, the first and the last not."""
    keep = np.random.default_rng(seed).random(SIZE) < 2 / 3
    keep[[0, -1]] = False
    return keep


def whole_clouds(seed, dimension=3):
    rng = np.random.default_rng(seed)
    body = bumpy(rng, 2 * SIZE, dimension)
    return body[:SIZE], move(body[SIZE:], random_pose(rng, dimension, angle=0.2, distance=0.1))


def with_gaps(points, keep, hole):
    gappy = points.copy()
    gappy[~keep] = hole
    return gappy


def outwards(points):
    """Normals, which are not finite where the points are not."""
    with np.errstate(invalid="ignore"):
        return points / np.linalg.norm(points, axis=1, keepdims=True)


def with_normals(points):
    cloud = bare(points)
    cloud.normals = o3d.utility.Vector3dVector(outwards(points))
    return cloud


def tensor(points):
    return o3d.t.geometry.PointCloud(o3d.core.Tensor(points))


def tensor_with_normals(points):
    cloud = tensor(points)
    cloud.point.normals = o3d.core.Tensor(outwards(points))
    return cloud


def bare(points):
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def as_array(value):
    return value.numpy() if hasattr(value, "numpy") else np.asarray(value)


GAPS = {"source": (True, False), "target": (False, True), "both": (True, True)}
HOLES = {"nan": np.nan, "inf": np.inf, "one coordinate": (0.1, np.nan, 0.2)}


@pytest.mark.parametrize("hole", HOLES)
@pytest.mark.parametrize("gaps", GAPS)
@pytest.mark.parametrize("make", [bare, with_normals, tensor, tensor_with_normals])
def test_clouds_with_gaps_are_registered_as_without_those_points(make, gaps, hole):
    whole, keeps = (
        whole_clouds(3),
        [measured(i) if gappy else np.full(SIZE, True) for i, gappy in enumerate(GAPS[gaps])],
    )
    clean = registration_adaptive_gmm(*(make(p[keep]) for p, keep in zip(whole, keeps, strict=True)), 0.1)
    gappy = [make(with_gaps(p, keep, HOLES[hole])) for p, keep in zip(whole, keeps, strict=True)]
    for sides in (gappy, [prepare(cloud) for cloud in gappy]):
        found = registration_adaptive_gmm(*sides, 0.1)
        np.testing.assert_array_equal(as_array(found.transformation), as_array(clean.transformation))
        np.testing.assert_array_equal(found.details.row_weights[keeps[0]], clean.details.row_weights)
        assert (found.details.row_weights[~keeps[0]] == 0.0).all()
        assert found.details.warnings == clean.details.warnings
        dropped = found.details.dropped_source, found.details.dropped_target
        assert dropped == tuple(int((~keep).sum()) for keep in keeps)
        # Indices are the input's, and all of its points count, as with Open3D.
        pairs = as_array(clean.correspondence_set).copy()
        source, target = (np.flatnonzero(keep) for keep in keeps)
        if pairs.shape[1:] == (2,):
            expected = np.column_stack([source[pairs[:, 0]], target[pairs[:, 1]]])
        else:
            expected = np.full((SIZE, *pairs.shape[1:]), -1)
            expected[source] = np.where(pairs < 0, -1, target[pairs])
        np.testing.assert_array_equal(as_array(found.correspondence_set), expected)
        assert found.fitness == pytest.approx(clean.fitness * keeps[0].mean(), rel=1e-12)
        assert found.inlier_rmse == clean.inlier_rmse


@pytest.mark.parametrize(("make", "theirs"), [(bare, legacy_reg), (tensor, tensor_reg)])
def test_gaps_in_the_source_are_counted_as_open3d_counts_them(make, theirs):
    source, target = whole_clouds(4)
    clouds = make(with_gaps(source, measured(0), np.nan)), make(target)
    ours = registration_adaptive_gmm(*clouds, 0.1)
    expected = theirs.evaluate_registration(*clouds, 0.1, ours.transformation)
    assert ours.fitness == expected.fitness
    np.testing.assert_allclose(ours.inlier_rmse, expected.inlier_rmse, rtol=1e-9)


@pytest.mark.parametrize("make", [bare, with_normals, tensor, tensor_with_normals])
@pytest.mark.parametrize("distance", [0.1, math.inf])
def test_clouds_with_gaps_are_thinned(make, distance):
    whole, keeps = whole_clouds(5), (measured(0), measured(1))
    clean, gappy = (
        registration_adaptive_gmm(
            *(make(change(p, keep)) for p, keep in zip(whole, keeps, strict=True)), distance, voxel_size=0.1
        )
        for change in (lambda p, keep: p[keep], lambda p, keep: with_gaps(p, keep, np.nan))
    )
    np.testing.assert_allclose(as_array(gappy.transformation), as_array(clean.transformation), rtol=0, atol=1e-12)
    assert gappy.fitness == clean.fitness


@pytest.mark.parametrize("dimension", [2, 3])
def test_arrays_with_gaps(dimension):
    whole, keeps = whole_clouds(6, dimension), (measured(0), measured(1))
    covariances = [np.random.default_rng(i).uniform(0.5, 2.0, SIZE)[:, None, None] * np.eye(dimension) for i in (0, 1)]
    colors = [np.random.default_rng(i).random((SIZE, 3)) for i in (0, 1)]
    kept = [[values[keep] for values, keep in zip(both, keeps, strict=True)] for both in (whole, covariances, colors)]
    # What is said of a point that is nowhere does not matter.
    gappy = [
        [with_gaps(values, keep, np.nan) for values, keep in zip(both, keeps, strict=True)]
        for both in (whole, covariances, colors)
    ]
    method = TransformationEstimationForAdaptiveGMM(color=True)
    found, expected = (
        register_points(*p, *c, estimation_method=method, source_colors=rgb[0], target_colors=rgb[1])
        for p, c, rgb in (gappy, kept)
    )
    np.testing.assert_array_equal(found.transformation, expected.transformation)
    np.testing.assert_array_equal(found.color_support[keeps[0]], expected.color_support)
    assert np.isnan(found.color_support[~keeps[0]]).all()


def test_a_colour_of_a_measured_point_is_still_looked_at():
    whole = whole_clouds(7)
    colors = np.random.default_rng(0).random((SIZE, 3))
    colors[5, 1] = np.nan
    points = with_gaps(whole[0], np.arange(SIZE) != 4, np.nan)
    with pytest.raises(ValueError, match=r"source\.colors: expected finite numbers, got nan at index \(5, 1\)"):
        register_points(points, whole[1], source_colors=colors, target_colors=colors)


def test_covariances_are_counted_among_the_points_that_are_there():
    source, target = whole_clouds(8)
    keep = np.arange(SIZE) < 150
    covariances = np.tile(np.eye(3), (SIZE, 1, 1))
    covariances[[7, 9]] = np.nan  # 2 of 150 are too many, of 700 they would not be
    gappy = with_gaps(source, keep, np.nan)
    with pytest.raises(ValueError, match=r"source\.covariances: 2 of 150 are not finite, the first at index 7"):
        register_points(gappy, target, source_covariances=covariances)
    covariances[7] = np.eye(3)
    found = register_points(gappy, target, source_covariances=covariances)
    assert found.dropped_source == SIZE - 149


def test_covariances_of_the_surface_know_nothing_of_the_gaps():
    points, _ = whole_clouds(9)
    keep = measured(2)
    found = stand_in_covariances(with_gaps(points, keep, np.inf))
    np.testing.assert_array_equal(found[keep], stand_in_covariances(points[keep]))
    assert np.isfinite(found).all()


def test_points_that_are_nowhere_have_no_partner():
    source, target = whole_clouds(10)
    keeps = measured(0), measured(1)
    gappy = [with_gaps(p, keep, np.nan) for p, keep in zip((source, target), keeps, strict=True)]
    for distance in (0.1, math.inf):
        fit = evaluate_registration(*gappy, distance, np.eye(4))
        clean = evaluate_registration(source[keeps[0]], target[keeps[1]], distance, np.eye(4))
        expected = np.column_stack(
            [np.flatnonzero(k)[i] for k, i in zip(keeps, clean.correspondence_set.T, strict=True)]
        )
        np.testing.assert_array_equal(fit.correspondence_set, expected)
        assert fit.inlier_rmse == clean.inlier_rmse
        assert fit.fitness == pytest.approx(clean.fitness * keeps[0].mean(), rel=1e-12)
        assert overlap_ratio(*gappy, np.eye(4), distance) == fit.fitness
        np.testing.assert_array_equal(
            information_matrix(*gappy, distance, np.eye(4)),
            information_matrix(source[keeps[0]], target[keeps[1]], distance, np.eye(4)),
        )


@pytest.mark.parametrize("make", [bare, tensor])
def test_too_few_points_for_a_surface_are_named(make):
    points, target = whole_clouds(11)
    with pytest.raises(ValueError, match=r"^source\.points: expected more than 3 to estimate normals from, got 3"):
        registration_adaptive_gmm(make(points[:3]), make(target), 0.1)
