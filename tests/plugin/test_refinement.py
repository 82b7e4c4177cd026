"""The last level: dense clouds on their cells, and on coarser ones while σ is wide, so that no point meets too many."""

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from numpy.testing import assert_array_equal
from shapes import bumpy, move

from adagmm_bench.pairs.lidar_scene import scan_pair
from adagmm_o3d import estimate_surface_covariances, register_points
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.mixtures import condensing
from adagmm_o3d.mixtures.condensing import Condensed
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.options import Criteria
from adagmm_o3d.pairs.cpu_pairs import PairLoop
from adagmm_o3d.result import StopReason
from adagmm_o3d.search import refinement

N, NOISE = 90_000, 0.002


@pytest.fixture(scope="module")
def dense():
    """Two samplings of one shape with noise, and the pose between them."""
    rng = np.random.default_rng(0)
    T = random_pose(rng, 3, angle=0.3, distance=0.2)
    points = bumpy(rng, 2 * N, 3) + NOISE * rng.normal(size=(2 * N, 3))
    return points[:N], move(points[N:], T), T


@pytest.fixture
def met(monkeypatch):
    """For each iteration on the last level, how many target points a source point meets, on average."""
    counted = []
    posterior_sums = PairLoop.posterior_sums

    def recorded(self, pose, sigma, *args):
        counted.append(count_met(*self._mixtures, pose, sigma))
        return posterior_sums(self, pose, sigma, *args)

    monkeypatch.setattr(PairLoop, "posterior_sums", recorded)
    return counted


def count_met(source, target, pose, sigma, probes=100):
    """How many target points lie where a weight may be more than 2**-24, counted for some source points."""
    some = np.linspace(0, len(source) - 1, probes).astype(int)
    moved = source.points[some] @ pose[:3, :3].T + pose[:3, 3]
    squares = ((moved[:, None] - target.points) ** 2).sum(axis=2)
    variances = sigma * (source.largest_variances[some, None] + target.largest_variances)
    return float((squares < 2.0 * np.log(2.0) * 24.0 * variances).sum(axis=1).mean())


@pytest.mark.slow
def test_dense_clouds_are_registered_by_their_cells(dense, monkeypatch):
    sizes = []
    make_pair_loop = refinement.make_pair_loop

    def recorded(source, target, device):
        sizes.append((len(source), len(target)))
        return make_pair_loop(source, target, device)

    monkeypatch.setattr(refinement, "make_pair_loop", recorded)
    source, target, T = dense
    result = register_points(source, target)
    assert np.max(sizes) < N // 3
    errors = pose_errors(T, result.transformation)
    assert errors.rotation_deg < 0.02 and errors.translation < 2e-4
    assert result.converged and result.row_weights.shape == (N,)


def room(rng, count):
    """Points on three walls with a box in the corner, 5 mm of noise, 4 m wide."""
    u, v = rng.uniform(0.0, 4.0, (2, count))
    zero = np.zeros(count)
    walls = np.stack([np.stack(p, axis=1) for p in ((u, v, zero), (u, zero, v), (zero, u, v))])
    points = walls[rng.integers(3, size=count), np.arange(count)]
    inside = (points < 1.0).all(axis=1)
    points[inside] = 1.0 - points[inside]
    return points + 0.005 * rng.normal(size=points.shape)


@pytest.mark.parametrize("count", [4_000, 9_000, 30_000])
@pytest.mark.parametrize("covariances", ["surface", "none"])
@pytest.mark.parametrize("start", ["identity", "global"])
def test_no_point_meets_too_many_whatever_the_scale(met, count, covariances, start):
    rng = np.random.default_rng(count)
    points = room(rng, count)
    target, source = points[points[:, 0] < 3.0], room(rng, count)
    source = move(source[source[:, 0] > 0.5], random_pose(rng, 3, angle=0.35, distance=0.5))
    given = [estimate_surface_covariances(p) if covariances == "surface" else None for p in (source, target)]
    register_points(source, target, *given, init="global" if start == "global" else None)
    assert met and max(met) < 2.0 * condensing.MOST_MET


@pytest.mark.parametrize("sigma", [1.0, 1e-1, 1e-2, 1e-3])
@pytest.mark.parametrize("surface", [True, False])
def test_components_of_a_wide_scale_are_few(sigma, surface):
    points = bumpy(np.random.default_rng(3), 15_000, 3)
    covariances = estimate_surface_covariances(points) if surface else None
    cloud = Condensed(make_mixture("source", points, covariances))
    side = cloud.at(sigma, refinement.STEP * sigma)
    assert count_met(side, side, np.eye(4), sigma) < 2.0 * condensing.MOST_MET


def test_cells_keep_the_moments_of_their_points():
    points = bumpy(np.random.default_rng(1), 30_000, 3)
    covariances = estimate_surface_covariances(points)
    mixture = make_mixture("source", points, covariances)
    cells = condensing._make_cells(mixture, np.full(len(points), 0.1))
    weights = cells.weights / len(points)
    assert len(cells.points) < 3000 and cells.weights.sum() == len(points)
    np.testing.assert_allclose(weights @ cells.points, points.mean(axis=0), rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        np.einsum("k,kij->ij", weights, cells.covariances), covariances.mean(axis=0), rtol=1e-9, atol=1e-12
    )
    second = np.einsum("k,ki,kj->ij", weights, cells.points, cells.points)
    second += np.einsum("k,kij->ij", weights, cells.scatters)
    np.testing.assert_allclose(second, points.T @ points / len(points), rtol=1e-9, atol=1e-12)


def test_cells_of_cells_keep_them_too():
    points = bumpy(np.random.default_rng(2), 60_000, 3)
    mixture = make_mixture("source", points, None)
    fine = condensing._make_cells(mixture, np.full(len(points), 0.03))
    bare = make_mixture("source", fine.points, None, fine.weights)
    coarse = condensing._make_cells(bare, np.full(len(fine.points), 0.2), fine.scatters)
    weights = coarse.weights / coarse.weights.sum()
    second = np.einsum("k,ki,kj->ij", weights, coarse.points, coarse.points)
    second += np.einsum("k,kij->ij", weights, coarse.scatters)
    np.testing.assert_allclose(second, points.T @ points / len(points), rtol=1e-9, atol=1e-12)


def test_points_of_unlike_certainty_are_not_merged():
    points = bumpy(np.random.default_rng(4), 20_000, 3)
    covariances = np.tile(np.eye(3), (len(points), 1, 1))
    covariances[::10] *= 1e6
    cells = condensing._make_cells(make_mixture("source", points, covariances), np.full(len(points), 0.1))
    variances = np.unique(np.round(np.log10(cells.covariances[:, 0, 0]), 6))
    np.testing.assert_array_equal(variances, [0.0, 6.0])


def test_a_place_seen_often_counts_no_more():
    scan = scan_pair(0, 0.5, 2.0)[0] / 13.0
    cells = Condensed(make_mixture("source", scan, estimate_surface_covariances(scan))).searched
    assert len(cells) < len(scan) // 3 and cells.weights.max() == condensing.FULL


def test_the_iterations_at_all_scales_are_bounded_together(dense):
    source, target, _ = dense
    levels = []
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=9)
    result = register_points(
        source, target, criteria=criteria, callback_after_iteration=lambda step: levels.append(step["scale_index"])
    )
    assert len(levels) == result.iterations == 9 and levels.count(refinement.LEVEL) == 6
    assert result.stop_reason is StopReason.MAX_ITERATION and result.row_weights.shape == (N,)


@pytest.mark.parametrize(
    "criteria", [o3d.pipelines.registration.ICPConvergenceCriteria(1e-6, 1e-6, 10**9), Criteria(1e-6, 10**15)]
)
def test_any_number_of_iterations_is_allowed(criteria):
    """Memory is taken for those that are done, not for all that might be."""
    rng = np.random.default_rng(0)
    points = bumpy(rng, 500, 3)
    result = register_points(points, move(points, random_pose(rng, 3, angle=0.1, distance=0.1)), criteria=criteria)
    assert result.converged and result.iterations < 1000


def test_portions_of_iterations_change_no_bit(monkeypatch):
    rng = np.random.default_rng(0)
    points = bumpy(rng, 1000, 3) + 0.02 * rng.normal(size=(1000, 3))
    clouds, criteria = (points[:500], points[500:]), Criteria(1e-9, 60)
    whole = register_points(*clouds, criteria=criteria)
    assert whole.iterations > 20
    monkeypatch.setattr(refinement, "PORTION", 7)
    assert_array_equal(register_points(*clouds, criteria=criteria).transformations, whole.transformations)
