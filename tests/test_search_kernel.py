"""The compiled search and the choice of representatives against NumPy, one iteration and one choice at a time."""

import math

import numpy as np
import pytest
import reference
from mixtures import random_points_and_covariances, random_pose

from adagmm_o3d.coarse import MergedMixture
from adagmm_o3d.expectation import MOST_UNMATCHED
from adagmm_o3d.kernels.farthest_points import farthest_points
from adagmm_o3d.start_search import Limits, Start, run_starts

FREE = {2: [2, 3, 4], 3: [0, 1, 2, 3, 4, 5]}
VOLUME = 20.0
LIMITS = Limits(floor=1e-4, least_unmatched=0.02, step=1e-12)
shapes = pytest.mark.parametrize(
    ("dimension", "isotropic"), [(2, True), (2, False), (3, True), (3, False)], ids=["2D", "2D a", "3D", "3D a"]
)


def lifted(matrices, zz):
    full = np.zeros((len(matrices), 3, 3))
    dimension = matrices.shape[1]
    full[:, :dimension, :dimension] = matrices
    if dimension == 2:
        full[:, 2, 2] = zz
    return full


class Side:
    """A cloud of components, some of which stand for several points, and what the kernel is given of it."""

    def __init__(self, rng, n, dimension, isotropic):
        self.points, self.covariances = random_points_and_covariances(rng, n, dimension, isotropic=isotropic)
        factors = 0.1 * rng.normal(size=(n, dimension, dimension))
        self.spreads = factors @ factors.transpose(0, 2, 1) * (0.0 if isotropic else 1.0)
        self.weights = rng.uniform(0.5, 2.0, n)
        self.weights /= self.weights.sum()
        points = np.zeros((n, 3))
        points[:, :dimension] = self.points
        self.mixture = MergedMixture(
            points, lifted(self.covariances, 1.0), lifted(self.spreads, 0.0), self.weights, dimension, isotropic
        )

    def at(self, sigma):
        return sigma * self.covariances + self.spreads


class Problem:
    def __init__(self, dimension, isotropic, seed=0):
        rng = np.random.default_rng([seed, dimension, isotropic])
        self.dimension = dimension
        self.source, self.target = (Side(rng, n, dimension, isotropic) for n in (9, 14))
        self.pose = random_pose(rng, dimension, angle=0.5, distance=0.3)

    def run(self, sigma=0.2, unmatched=0.3, fastest=0.5, iterations=1, follow=1.0, limits=LIMITS, poses=None):
        starts = []
        for pose in [self.pose] if poses is None else poses:
            whole = np.eye(4)
            whole[: self.dimension, : self.dimension] = pose[:-1, :-1]
            whole[: self.dimension, 3] = pose[:-1, -1]
            starts.append(Start(whole, sigma, unmatched, fastest, iterations, follow))
        return run_starts(self.source.mixture, self.target.mixture, starts, limits=limits, volume=VOLUME, level=0)

    def sums(self, pose, sigma, unmatched):
        """The naive pass, and the density of the points without a partner."""
        R, t = pose[:-1, :-1], pose[:-1, -1]
        uniform = (2.0 * math.pi) ** (0.5 * self.dimension) / VOLUME * unmatched / (1.0 - unmatched)
        y, S = reference.move(self.source.points, R, t), reference.turn(self.source.at(sigma), R)
        nothing = np.zeros(len(self.target.points))
        expected = reference.posterior_sums(
            y,
            S,
            self.target.points,
            self.target.at(sigma),
            uniform,
            nothing,
            0.0,
            self.source.weights,
            self.target.weights,
        )
        return expected, uniform

    def matched(self, sums, uniform):
        return float(self.source.weights @ (sums.densities / (sums.densities + uniform)))

    def likelihood(self, pose, sigma, unmatched):
        sums, uniform = self.sums(pose, sigma, unmatched)
        rows = self.source.weights @ np.log1p(sums.densities / uniform)
        return rows + self.target.weights @ np.log1p(sums.column_densities / uniform)

    def plain(self, pose):
        return pose if self.dimension == 3 else pose[np.ix_([0, 1, 3], [0, 1, 3])]


@shapes
def test_an_iteration_is_a_gauss_newton_step_on_the_naive_sums(dimension, isotropic):
    p = Problem(dimension, isotropic)
    (end,) = p.run(sigma=0.2, unmatched=0.3)
    sums, uniform = p.sums(p.pose, 0.2, 0.3)
    delta = -np.linalg.solve(sums.hessian, sums.gradient)
    turns = len(delta) - dimension
    R, t = reference.apply_tangent(
        np.concatenate([delta[:turns], np.zeros(dimension)]), p.pose[:-1, :-1], p.pose[:-1, -1]
    )
    expected = np.eye(dimension + 1)
    expected[:-1, :-1], expected[:-1, -1] = R, t + delta[turns:]
    np.testing.assert_allclose(p.plain(end.pose), expected, rtol=0, atol=2e-5)
    (iteration,) = end.iterations
    np.testing.assert_allclose(iteration.sigma, 0.2, rtol=1e-12)
    np.testing.assert_allclose(iteration.energy, sums.energy / sums.weight, rtol=1e-5)
    np.testing.assert_allclose(iteration.matched, p.matched(sums, uniform), rtol=1e-5)
    assert not end.settled


@shapes
def test_where_it_ends_is_judged_by_the_likelihood_of_both_clouds(dimension, isotropic):
    p = Problem(dimension, isotropic)
    for end in p.run(poses=[p.pose, random_pose(np.random.default_rng(1), dimension)]):
        expected = p.likelihood(p.plain(end.pose), end.sigma, LIMITS.judged_unmatched)
        np.testing.assert_allclose(end.log_likelihood, expected, rtol=1e-5)


@shapes
def test_sigma_follows_the_residuals_within_its_bounds(dimension, isotropic):
    p = Problem(dimension, isotropic)
    sums, uniform = p.sums(p.pose, 0.2, 0.3)
    observed = 0.2 * sums.energy / sums.weight / dimension
    for fastest, follow, floor in ((0.01, 1.0, 1e-4), (0.9, 0.0, 1e-4), (0.3, 0.5, 1e-4), (0.01, 0.0, 0.17)):
        limits = Limits(floor=floor, least_unmatched=0.02, step=1e-12)
        (end,) = p.run(fastest=fastest, follow=follow, limits=limits)
        np.testing.assert_allclose(end.sigma, max(fastest * 0.2, follow * observed, floor), rtol=1e-5)
    for least in (0.02, 0.98):
        (end,) = p.run(limits=Limits(floor=1e-4, least_unmatched=least, step=1e-12))
        expected = min(max(1.0 - p.matched(sums, uniform), least), MOST_UNMATCHED)
        np.testing.assert_allclose(end.unmatched, expected, rtol=1e-5)


@shapes
def test_it_is_settled_when_neither_pose_nor_sigma_move(dimension, isotropic):
    p = Problem(dimension, isotropic)
    limits = Limits(floor=0.1, least_unmatched=0.1, step=1e-4)
    (end,) = p.run(sigma=0.1, fastest=0.5, iterations=300, follow=0.0, limits=limits)
    assert end.settled and 3 < len(end.iterations) < 300 and end.sigma == 0.1
    before, last = (p.plain(iteration.pose) for iteration in end.iterations[-2:])
    assert np.linalg.norm(last - before) < 2e-4
    earlier, later = (p.plain(iteration.pose) for iteration in end.iterations[-3:-1])
    assert np.linalg.norm(later - earlier) > 1e-5
    (falling,) = p.run(sigma=0.3, fastest=0.98, iterations=3, follow=0.0, limits=Limits(0.1, 0.1, step=100.0))
    assert not falling.settled and len(falling.iterations) == 3
    (resting,) = p.run(sigma=0.3, fastest=0.995, iterations=3, follow=0.0, limits=Limits(0.1, 0.1, step=100.0))
    assert resting.settled and len(resting.iterations) == 1


@pytest.mark.parametrize(("n", "count"), [(3, 3), (40, 1), (40, 7), (200, 30)])
def test_representatives_are_each_the_farthest_from_those_before(n, count):
    points = np.random.default_rng(n + count).normal(size=(n, 3)) * (1.0, 0.7, 1.4)
    nearest = np.full(n, -1)
    farthest_points(np.ascontiguousarray(points.T), count, nearest)
    chosen = [int(np.argmax((points**2).sum(axis=1)))]
    while len(chosen) < count:
        distances = np.linalg.norm(points[:, None] - points[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(distances)))
    expected = np.linalg.norm(points[:, None] - points[chosen], axis=2).argmin(axis=1)
    np.testing.assert_array_equal(nearest, expected)
