"""The compiled search and the choice of representatives against NumPy, one iteration and one choice at a time."""

import math
from dataclasses import replace

import numpy as np
import pytest
import reference
from mixtures import random_points_and_covariances, random_pose

from adagmm_o3d.em.expectation import MOST_UNMATCHED
from adagmm_o3d.em.runs import Limits, Start, run_starts
from adagmm_o3d.em.unmatched import COMPARED_SIGMA, uniform_density
from adagmm_o3d.kernels.cpu.acceleration import (
    LOG_SIGMA,
    STATE,
    UNMATCHED_SHARE,
    accelerated_step,
    empty_memory,
    forget,
)
from adagmm_o3d.kernels.cpu.convolved_pass import FEW_TILES
from adagmm_o3d.kernels.cpu.culling import GROUP, TILE
from adagmm_o3d.kernels.cpu.farthest_points import farthest_points
from adagmm_o3d.kernels.cpu.nearest_other import nearest_other_sq
from adagmm_o3d.mixtures.merging import COARSE_BITS, MergedMixture
from adagmm_o3d.result import StopReason

FREE = {2: [2, 3, 4], 3: [0, 1, 2, 3, 4, 5]}
# As far as float32 tells; what the search leaves out by itself has a test of its own.
EVERY = 40.0
LIMITS = Limits(floor=1e-4, least_unmatched=0.02, relative_rmse=1e-24, bits=EVERY)
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
        self.dimension, self.isotropic = dimension, isotropic
        self.build()

    def build(self):
        """The mixture of what the side is now."""
        points = np.zeros((len(self.points), 3))
        points[:, : self.dimension] = self.points
        self.mixture = MergedMixture(
            points,
            lifted(self.covariances, 1.0),
            lifted(self.spreads, 0.0),
            self.weights,
            np.linalg.eigvalsh(self.covariances)[:, -1],
            self.dimension,
            self.isotropic,
        )

    def at(self, sigma):
        return sigma * self.covariances + self.spreads


class Problem:
    def __init__(self, dimension, isotropic, seed=0, sizes=(9, 14)):
        rng = np.random.default_rng([seed, dimension, isotropic])
        self.dimension = dimension
        self.source, self.target = (Side(rng, n, dimension, isotropic) for n in sizes)
        self.pose = random_pose(rng, dimension, angle=0.5, distance=0.3)

    def run(
        self,
        sigma=0.2,
        unmatched=0.3,
        fastest=0.5,
        iterations=1,
        follow=1.0,
        limits=LIMITS,
        poses=None,
        compared_at=COMPARED_SIGMA,
    ):
        starts = []
        for pose in [self.pose] if poses is None else poses:
            whole = np.eye(4)
            whole[: self.dimension, : self.dimension] = pose[:-1, :-1]
            whole[: self.dimension, 3] = pose[:-1, -1]
            starts.append(Start(whole, sigma, unmatched, fastest, iterations, follow))
        return run_starts(
            self.source.mixture, self.target.mixture, starts, limits=limits, level=0, compared_at=compared_at
        )

    def sums(self, pose, sigma, unmatched, compared_at=None):
        """The naive pass, and the density of the points without a partner."""
        R, t = pose[:-1, :-1], pose[:-1, -1]
        uniform = uniform_density(unmatched, compared_at or sigma, self.dimension)
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

    def likelihood(self, pose, sigma, unmatched, compared_at=COMPARED_SIGMA):
        sums, uniform = self.sums(pose, sigma, unmatched, compared_at)
        rows = self.source.weights @ np.log1p(sums.densities / uniform)
        return rows + self.target.weights @ np.log1p(sums.column_densities / uniform)

    def plain(self, pose):
        return pose if self.dimension == 3 else pose[np.ix_([0, 1, 3], [0, 1, 3])]

    def newton_step(self, sums, pose):
        """The tangent (6,) that the M-step takes."""
        delta = np.zeros(6)
        delta[FREE[self.dimension]] = -np.linalg.solve(sums.hessian, sums.gradient)
        return delta

    def moved(self, delta, pose):
        """`pose` turned by the first part of the tangent (6,) about the origin, then shifted by the second."""
        delta = delta[FREE[self.dimension]]
        turns = len(delta) - self.dimension
        turn = np.concatenate([delta[:turns], np.zeros(self.dimension)])
        new = np.eye(self.dimension + 1)
        new[:-1, :-1], new[:-1, -1] = reference.apply_tangent(turn, pose[:-1, :-1], pose[:-1, -1])
        new[:-1, -1] += delta[turns:]
        return new

    def expected_run(self, sigma, unmatched, fastest, count, follow, limits):
        """EM by the naive sums: (pose, σ, unmatched share) after each of `count` iterations."""
        pose, memory, taken, states = self.pose, empty_memory(), np.empty(STATE), []
        forget(memory)
        for _ in range(count):
            sums, uniform = self.sums(pose, sigma, unmatched)
            observed = follow * sigma * sums.energy / sums.weight / self.dimension
            wanted, slowest = max(observed, limits.floor), fastest * sigma
            share = min(max(1.0 - self.matched(sums, uniform), limits.least_unmatched), MOST_UNMATCHED)
            new = max(slowest, wanted)
            residual = np.concatenate([self.newton_step(sums, pose), [math.log(new / sigma), share - unmatched]])
            if limits.accelerated and slowest <= wanted:
                accelerated_step(residual, math.sqrt(sigma), memory, taken)
                new = max(sigma * math.exp(taken[LOG_SIGMA]), limits.floor)
            else:
                forget(memory)
                taken[:] = residual
            pose = self.moved(taken, pose)
            unmatched = min(max(unmatched + taken[UNMATCHED_SHARE], limits.least_unmatched), MOST_UNMATCHED)
            sigma = new
            states.append((pose, sigma, unmatched))
        return states


@shapes
def test_an_iteration_is_a_gauss_newton_step_on_the_naive_sums(dimension, isotropic):
    p = Problem(dimension, isotropic)
    (end,) = p.run(sigma=0.2, unmatched=0.3)
    sums, uniform = p.sums(p.pose, 0.2, 0.3)
    np.testing.assert_allclose(p.plain(end.pose), p.moved(p.newton_step(sums, p.pose), p.pose), rtol=0, atol=2e-5)
    (iteration,) = end.iterations
    np.testing.assert_allclose(iteration.sigma, 0.2, rtol=1e-12)
    np.testing.assert_allclose(iteration.energy, sums.energy / sums.weight, rtol=1e-5)
    np.testing.assert_allclose(iteration.matched, p.matched(sums, uniform), rtol=1e-5)
    assert not end.settled


@shapes
@pytest.mark.parametrize("accelerated", [False, True])
def test_iterations_follow_each_other_as_on_the_naive_sums(dimension, isotropic, accelerated):
    # EM is accelerated where σ is that of the residuals or the floor, not where it falls as fast as it may: at first,
    # in between, or because a step would go farther.
    p = Problem(dimension, isotropic)
    for sigma, follow, floor in ((0.3, 1.0, 0.01), (0.3, 0.0, 0.15), (0.1, 1.0, 0.001)):
        limits = Limits(floor=floor, least_unmatched=0.02, relative_rmse=0.0, accelerated=accelerated, bits=EVERY)
        expected = p.expected_run(sigma, 0.3, 0.8, 8, follow, limits)
        (end,) = p.run(sigma=sigma, unmatched=0.3, fastest=0.8, iterations=8, follow=follow, limits=limits)
        poses = [p.plain(iteration.pose) for iteration in end.iterations]
        np.testing.assert_allclose(poses, [pose for pose, _, _ in expected], rtol=0, atol=1e-4)
        sigmas = [iteration.sigma for iteration in end.iterations[1:]] + [end.sigma]
        np.testing.assert_allclose(sigmas, [sigma for _, sigma, _ in expected], rtol=1e-4)
        np.testing.assert_allclose(end.unmatched, expected[-1][2], rtol=1e-4)


@shapes
def test_acceleration_leads_to_the_same_end_sooner(dimension, isotropic):
    # From near an optimum: from farther away a long step may end in another one.
    p = Problem(dimension, isotropic)
    limits = Limits(floor=0.1, least_unmatched=0.02, relative_rmse=1e-9, bits=EVERY)
    (plain,) = p.run(sigma=0.1, fastest=0.9, iterations=500, follow=0.0, limits=limits)
    beside = p.moved(np.full(6, 0.05), p.plain(plain.pose))
    ends = []
    for accelerated in (False, True):
        limits = Limits(floor=0.1, least_unmatched=0.02, relative_rmse=1e-9, accelerated=accelerated, bits=EVERY)
        ends += p.run(sigma=0.1, fastest=0.9, iterations=500, follow=0.0, limits=limits, poses=[beside])
    slow, fast = ends
    assert plain.settled and slow.settled and fast.settled
    for end in ends:
        np.testing.assert_allclose(end.pose, plain.pose, rtol=0, atol=2e-3)
        np.testing.assert_allclose([end.sigma, end.unmatched], [plain.sigma, plain.unmatched], rtol=2e-3)
    assert len(fast.iterations) < 0.7 * len(slow.iterations)


@shapes
def test_where_it_ends_is_judged_by_the_likelihood_of_both_clouds(dimension, isotropic):
    p = Problem(dimension, isotropic)
    for end in p.run(poses=[p.pose, random_pose(np.random.default_rng(1), dimension)]):
        # The sums are relative to the uniform part: that is an end's own, and the same unit of density for all.
        expected = p.likelihood(p.plain(end.pose), end.sigma, end.unmatched) + 2.0 * math.log(end.unmatched)
        np.testing.assert_allclose(end.log_likelihood, expected, rtol=1e-5, atol=1e-5)


@shapes
def test_sigma_follows_the_residuals_within_its_bounds(dimension, isotropic):
    p = Problem(dimension, isotropic)
    sums, uniform = p.sums(p.pose, 0.2, 0.3)
    observed = 0.2 * sums.energy / sums.weight / dimension
    for fastest, follow, floor in ((0.01, 1.0, 1e-4), (0.9, 0.0, 1e-4), (0.3, 0.5, 1e-4), (0.01, 0.0, 0.17)):
        limits = Limits(floor=floor, least_unmatched=0.02, relative_rmse=1e-24, bits=EVERY)
        (end,) = p.run(fastest=fastest, follow=follow, limits=limits)
        np.testing.assert_allclose(end.sigma, max(fastest * 0.2, follow * observed, floor), rtol=1e-5)
    for least in (0.02, 0.98):
        (end,) = p.run(limits=Limits(floor=1e-4, least_unmatched=least, relative_rmse=1e-24, bits=EVERY))
        expected = min(max(1.0 - p.matched(sums, uniform), least), MOST_UNMATCHED)
        np.testing.assert_allclose(end.unmatched, expected, rtol=1e-5)


@shapes
def test_it_is_settled_when_neither_pose_nor_sigma_move(dimension, isotropic):
    p = Problem(dimension, isotropic)
    limits = Limits(floor=0.1, least_unmatched=0.1, relative_rmse=1e-7, bits=EVERY)
    (end,) = p.run(sigma=0.1, fastest=0.5, iterations=300, follow=0.0, limits=limits)
    assert end.settled and 3 < len(end.iterations) < 300 and end.sigma == 0.1
    # ‖δ‖ is the distance between poses in turned and shifted directions, up to √2 for the rotation's matrix.
    before, last = (p.plain(iteration.pose) for iteration in end.iterations[-2:])
    assert np.linalg.norm(last - before) < 2e-4
    earlier, later = (p.plain(iteration.pose) for iteration in end.iterations[-3:-1])
    assert np.linalg.norm(later - earlier) > 1e-5
    never_moving = Limits(0.1, 0.1, relative_rmse=1e5, bits=EVERY)
    (falling,) = p.run(sigma=0.3, fastest=0.98, iterations=3, follow=0.0, limits=never_moving)
    assert not falling.settled and len(falling.iterations) == 3
    (resting,) = p.run(sigma=0.3, fastest=0.995, iterations=3, follow=0.0, limits=never_moving)
    assert resting.settled and len(resting.iterations) == 1


@shapes
def test_clouds_that_do_not_see_each_other_have_no_iteration(dimension, isotropic):
    p = Problem(dimension, isotropic)
    p.pose[:-1, -1] = 1e4
    (end,) = p.run(iterations=5, limits=replace(LIMITS, bits=24.0))
    assert end.stop_reason is StopReason.NO_OVERLAP and not end.settled and end.iterations == ()
    np.testing.assert_array_equal(p.plain(end.pose), p.pose)


@pytest.mark.parametrize("iterations", [1, 60])
def test_pairs_that_leave_the_pose_undetermined_are_said_to(iterations):
    # Two points leave the turn about their line free.
    p = Problem(3, True, sizes=(2, 2))
    (end,) = p.run(iterations=iterations, limits=replace(LIMITS, relative_rmse=1e-3))
    assert end.stop_reason is StopReason.DEGENERATE and np.isfinite(end.pose).all()
    (end,) = Problem(3, True).run(iterations=iterations, limits=replace(LIMITS, relative_rmse=1e-3))
    assert end.stop_reason is (StopReason.MAX_ITERATION if iterations == 1 else StopReason.CONVERGED)


@shapes
def test_what_a_step_may_be_to_rest_grows_with_sigma(dimension, isotropic):
    p = Problem(dimension, isotropic)
    sums, _ = p.sums(p.pose, 0.2, 0.3)
    moved = float((p.newton_step(sums, p.pose) ** 2).sum()) / 0.2
    for share, settled in ((1.001, True), (0.999, False)):
        limits = Limits(floor=0.2, least_unmatched=0.02, relative_rmse=share * moved, bits=EVERY)
        (end,) = p.run(sigma=0.2, unmatched=0.3, follow=0.0, limits=limits)
        assert end.settled is settled


@shapes
def test_tiles_and_groups_out_of_reach_are_left_out_and_nothing_else(dimension, isotropic):
    # Near components within reach of each other, in several groups of tiles; with spreads where anisotropic.
    p = Problem(dimension, isotropic, sizes=(10, 2 * GROUP * TILE + 5))
    for sigma in (1e-2, 1e-3):
        (end,) = p.run(sigma=sigma, unmatched=0.3)
        sums, uniform = p.sums(p.pose, sigma, 0.3)
        (iteration,) = end.iterations
        np.testing.assert_allclose(iteration.matched, p.matched(sums, uniform), rtol=2e-5)
        np.testing.assert_allclose(iteration.energy, sums.energy / sums.weight, rtol=1e-4)
        expected = p.likelihood(p.plain(end.pose), end.sigma, end.unmatched) + 2.0 * math.log(end.unmatched)
        np.testing.assert_allclose(end.log_likelihood, expected, rtol=1e-4)


@pytest.mark.parametrize("vague", ["source", "target"])
@pytest.mark.parametrize("what", ["covariances", "spreads"])
@pytest.mark.parametrize("size", [TILE + 40, (FEW_TILES + 2) * TILE], ids=["whole tiles", "points of tiles"])
def test_a_pair_reaches_as_far_as_the_variance_of_either_side_does(vague, what, size):
    # It weighs exp(-12.5), 2^-18: within the reach of the vague side, far out of that of the sharp one.
    p, sigma = Problem(3, False, sizes=(9, size)), 0.5
    p.pose = np.eye(4)
    p.source.points *= 1e-3
    p.target.points *= 1e-3
    p.target.points[:TILE, 0] += 1.0
    p.target.points[TILE:, 0] += 50.0
    for side in (p.source, p.target):
        scale = 1.0 / 25.0 if side is getattr(p, vague) else 1e-6
        for name in ("covariances", "spreads"):
            factor = 1e-6 if name != what else scale
            getattr(side, name)[:] = factor * np.eye(3) / (sigma if name == "covariances" else 1.0)
        side.build()
    (end,) = p.run(sigma=sigma, unmatched=0.3, limits=replace(LIMITS, bits=24.0))
    sums, uniform = p.sums(p.pose, sigma, 0.3)
    np.testing.assert_allclose(end.iterations[0].matched, p.matched(sums, uniform), rtol=2e-3)


def test_an_extrapolated_scale_stays_above_its_floor():
    limits, reached = replace(LIMITS, accelerated=True), 0
    for seed in range(6):
        p = Problem(3, False, seed=seed)
        (free,) = p.run(iterations=40, limits=limits)
        floor = 1.5 * min(i.sigma for i in free.iterations)
        (end,) = p.run(iterations=40, limits=replace(limits, floor=floor))
        least = min(end.sigma, *(i.sigma for i in end.iterations))
        assert least >= floor
        reached += least < 1.001 * floor
    assert reached >= 3


@shapes
def test_the_search_leaves_out_no_pair_that_a_coarse_mixture_tells(dimension, isotropic):
    p = Problem(dimension, isotropic, sizes=(10, 300))
    (every,) = p.run(sigma=1e-2)
    (end,) = p.run(sigma=1e-2, limits=replace(LIMITS, bits=COARSE_BITS))
    lost = every.iterations[0].matched - end.iterations[0].matched
    assert 0.0 < lost + 1e-9 < 2.0**-COARSE_BITS * 300


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


@pytest.mark.parametrize("n", [2, 3, 40])
def test_nearest_other_points_are_those_of_all_distances(n):
    points = np.random.default_rng(n).normal(size=(n, 3))
    probes = np.unique([0, n // 2, n - 1])
    squares = np.empty(len(probes))
    nearest_other_sq(np.ascontiguousarray(points.T), probes, squares)
    every = ((points[probes, None] - points) ** 2).sum(axis=-1)
    every[np.arange(len(probes)), probes] = np.inf
    np.testing.assert_allclose(squares, every.min(axis=1), rtol=1e-12)
