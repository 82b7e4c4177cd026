"""The kernels against the naive reference: odd sizes, both dimensions, isotropic and not, culled and dense."""

import numba
import numpy as np
import pytest
import reference
from mixtures import random_colours, random_points_and_covariances, random_pose

from adagmm_o3d.kernels.cpu.convolved_pass import FEW_TILES
from adagmm_o3d.kernels.cpu.culling import CHUNK, CLUSTER, GROUP, RUN, TILE
from adagmm_o3d.kernels.cpu.exp2 import exp2_float32
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.layout import SHARE
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.pairs.cpu_pairs import BANDS, CUT_BITS, PairLoop

FREE = {2: [2, 3, 4], 3: [0, 1, 2, 3, 4, 5]}
SHAPES = [("2D", 2, True), ("2D anisotropic", 2, False), ("3D", 3, True), ("3D anisotropic", 3, False)]
shapes = pytest.mark.parametrize(("dimension", "isotropic"), [s[1:] for s in SHAPES], ids=[s[0] for s in SHAPES])


def lift(pose):
    if len(pose) == 4:
        return pose
    lifted = np.eye(4)
    lifted[:2, :2], lifted[:2, 3] = pose[:2, :2], pose[:2, 2]
    return lifted


class Case:
    """A pair of random clouds, its pair loop, and the reference's answer."""

    def __init__(self, seed, m, n, dimension, isotropic, sigmas=(0.2, 0.35)):
        rng = np.random.default_rng(seed)
        self.source, self.source_covariances = random_points_and_covariances(rng, m, dimension, isotropic=isotropic)
        self.target, self.target_covariances = random_points_and_covariances(rng, n, dimension, isotropic=isotropic)
        self.pose, self.sigmas, self.dimension = random_pose(rng, dimension), sigmas, dimension
        self.loop = PairLoop(
            make_mixture("source", self.source, self.source_covariances),
            make_mixture("target", self.target, self.target_covariances),
        )
        self.R, self.t = self.pose[:-1, :-1], self.pose[:-1, -1]
        self.y = reference.move(self.source, self.R, self.t)
        self.B = np.linalg.inv(sigmas[0] * reference.turn(self.source_covariances, self.R))
        self.A = np.linalg.inv(sigmas[1] * self.target_covariances)

    def sums(self):
        return self.loop.sums(lift(self.pose), *self.sigmas)

    def unit(self):
        """What the kernels divide the reference's weights by: the largest amplitude on either side."""
        largest = [np.linalg.det(p).max() ** 0.5 for p in (self.A, self.B)]
        return largest[0] * largest[1]


@shapes
@pytest.mark.parametrize("m", [3, CLUSTER - 1, CLUSTER, CHUNK + 1])
@pytest.mark.parametrize("n", [3, TILE - 1, TILE, TILE + 1, 300])
def test_pair_sums_match_the_naive_reference(dimension, isotropic, m, n):
    case = Case(7 * m + n, m, n, dimension, isotropic)
    sums = case.sums()
    C = reference.pair_weights(case.y, case.B, case.target, case.A) / case.unit()
    args = (C, case.y, case.B, case.target, case.A)
    free = FREE[dimension]
    hessian = 0.5 * reference.gauss_newton_hessian(*args, turning=False)
    gradient = 0.5 * reference.gradient(*args)
    np.testing.assert_allclose(sums.row_weights, C.sum(axis=1), rtol=2e-6, atol=1e-7 * C.sum() / m)
    np.testing.assert_allclose(sums.weight, C.sum(), rtol=1e-6, atol=0)
    np.testing.assert_allclose(sums.energy, reference.energy(*args), rtol=1e-6, atol=0)
    np.testing.assert_allclose(sums.hessian[np.ix_(free, free)], hessian, rtol=1e-5, atol=1e-6 * np.abs(hessian).max())
    np.testing.assert_allclose(sums.gradient[free], gradient, rtol=1e-5, atol=1e-6 * np.abs(hessian).max())


@shapes
def test_the_gradient_is_the_slope_of_equation_5(dimension, isotropic):
    case = Case(1, 40, 50, dimension, isotropic)
    C = reference.pair_weights(case.y, case.B, case.target, case.A) / case.unit()
    slope = reference.gradient_by_differences(
        C, case.source, np.linalg.inv(case.sigmas[0] * case.source_covariances), case.target, case.A, case.R, case.t
    )
    gradient = 2.0 * case.sums().gradient[FREE[dimension]]
    np.testing.assert_allclose(gradient, slope, rtol=1e-4, atol=1e-5 * np.abs(slope).max())


@shapes
@pytest.mark.parametrize("mutuality", [0.0, 0.3, 0.5])
@pytest.mark.parametrize(("m", "n"), [(3, 5), (CLUSTER + 1, TILE), (CHUNK + 1, 300), (BANDS * CLUSTER + 9, 7)])
def test_posterior_sums_match_the_naive_reference(dimension, isotropic, mutuality, m, n):
    case = Case(11 * m + n, m, n, dimension, isotropic)
    sigma, uniform = 0.2, 0.05
    S, T = sigma * reference.turn(case.source_covariances, case.R), sigma * case.target_covariances
    args = (case.y, S, case.target, T, uniform)
    columns = reference.posterior_sums(*args, np.zeros(n), 0.0).column_densities
    expected = reference.posterior_sums(*args, columns, mutuality)
    sums = case.loop.posterior_sums(lift(case.pose), sigma, uniform, mutuality)
    free = FREE[dimension]
    scale = np.abs(expected.hessian).max()
    np.testing.assert_allclose(sums.hessian[np.ix_(free, free)], expected.hessian, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose(sums.gradient[free], expected.gradient, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose([sums.weight, sums.energy], [expected.weight, expected.energy], rtol=1e-6, atol=0)
    posterior = expected.densities / (expected.densities + uniform)
    np.testing.assert_allclose(sums.row_weights, posterior, rtol=2e-6, atol=1e-9)
    np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=2e-6, atol=1e-9)
    np.testing.assert_allclose(sums.overlap, posterior.mean(), rtol=1e-6, atol=0)


@shapes
@pytest.mark.parametrize("mutuality", [0.0, 0.5])
@pytest.mark.parametrize(("m", "n"), [(3, 5), (CHUNK + 1, 300)])
def test_posterior_sums_with_colours_match_the_naive_reference(dimension, isotropic, mutuality, m, n):
    case = Case(17 * m + n, m, n, dimension, isotropic)
    colours, model = random_colours(m, n)
    loop = PairLoop(
        make_mixture("source", case.source, case.source_covariances).coloured(colours[0]),
        make_mixture("target", case.target, case.target_covariances).coloured(colours[1]),
    )
    ratios = reference.colour_ratios(*colours, model)
    assert (ratios == ratios.min()).any() and (ratios > ratios.min()).any()  # some lie, some do not
    sigma, uniform = 0.2, 0.05
    S, T = sigma * reference.turn(case.source_covariances, case.R), sigma * case.target_covariances
    args = (case.y, S, case.target, T, uniform)
    columns = reference.posterior_sums(*args, np.zeros(n), 0.0, ratios=ratios).column_densities
    expected = reference.posterior_sums(*args, columns, mutuality, ratios=ratios)
    sums = loop.posterior_sums(lift(case.pose), sigma, uniform, mutuality, model)
    free = FREE[dimension]
    scale = np.abs(expected.hessian).max()
    np.testing.assert_allclose(sums.hessian[np.ix_(free, free)], expected.hessian, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose(sums.gradient[free], expected.gradient, rtol=1e-5, atol=1e-6 * scale)
    np.testing.assert_allclose([sums.weight, sums.energy], [expected.weight, expected.energy], rtol=2e-6, atol=0)
    posterior = expected.densities / (expected.densities + uniform)
    np.testing.assert_allclose(sums.row_weights, posterior, rtol=3e-6, atol=1e-9)
    np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=3e-6, atol=1e-9)
    alone = case.loop.posterior_sums(lift(case.pose), sigma, uniform, mutuality)
    plain = loop.posterior_sums(lift(case.pose), sigma, uniform, mutuality)
    np.testing.assert_array_equal(plain.total, alone.total)  # colours that do not count change no bit


@shapes
@pytest.mark.parametrize("sigmas", [(2e-4, 1e-4), (3e-3, 1e-7), (1e-7, 3e-3)])
def test_leaving_out_far_tiles_changes_nothing_worth_mentioning(dimension, isotropic, sigmas):
    # Clouds much wider than a component reaches: so nearly every tile is skipped. The vaguer side reaches farther.
    case = Case(2, 400, 900, dimension, isotropic, sigmas=sigmas)
    C = reference.pair_weights(case.y, case.B, case.target, case.A) / case.unit()
    sums = case.sums()
    np.testing.assert_allclose(sums.weight, C.sum(), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        sums.energy, reference.energy(C, case.y, case.B, case.target, case.A), rtol=1e-4, atol=1e-4
    )


@pytest.mark.slow
@shapes
@pytest.mark.parametrize("sigma", [3e-4, 1e-2])
def test_leaving_out_far_points_changes_the_posteriors_by_no_more_than_float32_does(dimension, isotropic, sigma):
    # Points are left out one by one, and whole tiles and groups of them. At σ = 3e-4 the rounding of coordinates alone
    # changes the weight of a pair that is some deviations apart by 1e-5.
    case = Case(12, 700, 1500, dimension, isotropic)
    uniform, mutuality = 0.05, 0.5
    S, T = sigma * reference.turn(case.source_covariances, case.R), sigma * case.target_covariances
    args = (case.y, S, case.target, T, uniform)
    columns = reference.posterior_sums(*args, np.zeros(len(case.target)), 0.0).column_densities
    expected = reference.posterior_sums(*args, columns, mutuality)
    sums = case.loop.posterior_sums(lift(case.pose), sigma, uniform, mutuality)
    free, scale = FREE[dimension], np.abs(expected.hessian).max()
    np.testing.assert_allclose([sums.weight, sums.energy], [expected.weight, expected.energy], rtol=5e-6, atol=0)
    np.testing.assert_allclose(sums.hessian[np.ix_(free, free)], expected.hessian, rtol=1e-5, atol=3e-6 * scale)
    np.testing.assert_allclose(sums.gradient[free], expected.gradient, rtol=1e-5, atol=3e-6 * scale)
    np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=3e-5, atol=3e-6)


@shapes
def test_whole_groups_of_far_tiles_are_left_out_and_nothing_else(dimension, isotropic):
    case = Case(8, 20, 3 * GROUP * TILE + 5, dimension, isotropic)
    sigma, uniform = 3e-3, 0.05
    S, T = sigma * reference.turn(case.source_covariances, case.R), sigma * case.target_covariances
    nothing = np.zeros(len(case.target))
    expected = reference.posterior_sums(case.y, S, case.target, T, uniform, nothing, 0.0)
    sums = case.loop.posterior_sums(lift(case.pose), sigma, uniform)
    posterior = expected.densities / (expected.densities + uniform)
    np.testing.assert_allclose(sums.row_weights, posterior, rtol=2e-5, atol=1e-6)
    most = expected.column_densities.max()
    np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=2e-5, atol=1e-6 * most)
    np.testing.assert_allclose([sums.weight, sums.energy], [expected.weight, expected.energy], rtol=2e-5, atol=0)
    free, scale = FREE[dimension], np.abs(expected.hessian).max()
    np.testing.assert_allclose(sums.hessian[np.ix_(free, free)], expected.hessian, rtol=2e-5, atol=5e-6 * scale)
    np.testing.assert_allclose(sums.gradient[free], expected.gradient, rtol=2e-5, atol=5e-6 * scale)


@pytest.mark.parametrize(("dimension", "sigma"), [(2, 0.02), (3, 0.04)])
def test_more_points_in_reach_than_are_gathered_at_once(dimension, sigma):
    # Every group of tiles lies partly within reach of the one cluster.
    case = Case(9, CLUSTER, 9 * GROUP * TILE // 2, dimension, isotropic=True)
    case.y[:], uniform = 0.02 * case.y, 0.05
    loop = PairLoop(make_mixture("source", case.y, None), make_mixture("target", case.target, None))
    eye = np.broadcast_to(np.eye(dimension), (len(case.target), dimension, dimension))
    nothing = np.zeros(len(case.target))
    args = (case.y, sigma * eye[:CLUSTER], case.target, sigma * eye, uniform, nothing, 0.0)
    expected, sums = reference.posterior_sums(*args), loop.posterior_sums(np.eye(4), sigma, uniform)
    in_reach = np.linalg.norm(case.target, axis=1) < np.sqrt(2.0 * sigma * CUT_BITS / LOG2_SCALE)
    assert RUN < in_reach.sum() < 0.9 * len(case.target)
    posterior = expected.densities / (expected.densities + uniform)
    np.testing.assert_allclose(sums.row_weights, posterior, rtol=2e-5, atol=1e-6)
    most = expected.column_densities.max()
    np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=2e-5, atol=1e-6 * most)
    np.testing.assert_allclose([sums.weight, sums.energy], [expected.weight, expected.energy], rtol=2e-5, atol=0)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("in_reach", ["some", "all"])
def test_what_tiles_are_filled_up_with_says_nothing(dimension, in_reach):
    # A source so sharp that its own covariances have no determinant in float32; the sums of both sides' have.
    rng = np.random.default_rng(10)
    n = TILE + 4 if in_reach == "all" else (FEW_TILES + 1) * TILE + 4  # of more tiles than a few, points are picked
    factors = rng.normal(size=(n, dimension, dimension))
    covariances = np.eye(dimension) + 0.1 * factors @ factors.transpose(0, 2, 1)
    sigma, uniform = 1e-7 if dimension == 3 else 1e-13, 0.05
    target = rng.normal(size=(n, dimension)) * (1.0 if in_reach == "some" else np.sqrt(sigma))
    source = target[0] + 0.3 * np.sqrt(sigma) * rng.normal(size=(5, dimension))
    sharp = 1e-7 * covariances[:5]
    loop = PairLoop(make_mixture("source", source, sharp), make_mixture("target", target, covariances))
    sums = loop.posterior_sums(np.eye(4), sigma, uniform)
    assert np.isfinite(sums.hessian).all() and np.isfinite(sums.gradient).all()
    nothing = np.zeros(len(target))
    expected = reference.posterior_sums(source, sigma * sharp, target, sigma * covariances, uniform, nothing, 0.0)
    np.testing.assert_allclose(sums.row_weights, expected.densities / (expected.densities + uniform), rtol=1e-4)


def seen(source, target, sigma):
    """Whether source points have any density of the target at them at all."""
    loop = PairLoop(make_mixture("source", source, None), make_mixture("target", target, None))
    return loop.posterior_sums(np.eye(4), sigma, 1e-12).row_weights > 0.5


def test_the_variances_of_both_sides_reach_to_far_tiles():
    # Where a pair weighs exp(-10): within the reach of 2^-24, beyond what one of the two variances reaches.
    rng = np.random.default_rng(0)
    near, far = 1e-3 * rng.normal(size=(CLUSTER, 3)), [1.0, 0.0, 0.0] + 1e-3 * rng.normal(size=(TILE, 3))
    assert seen(near, far, 1.0 / 40.0).all()
    assert not seen(near, far, 1.0 / 400.0).any()


def test_tiles_out_of_reach_are_not_looked_at_though_others_of_their_group_are():
    rng = np.random.default_rng(1)
    near = 0.01 * rng.normal(size=(TILE, 3))
    far = [2.0, 0.0, 0.0] + 0.01 * rng.normal(size=(FEW_TILES * TILE, 3))
    target = make_mixture("target", np.concatenate([near, far]), None)
    loop = PairLoop(make_mixture("source", near + 1e-3, None), target)
    expected = loop.posterior_sums(np.eye(4), 1e-4, 0.1)
    loop._plain[SHARE, TILE:] = np.nan
    sums = loop.posterior_sums(np.eye(4), 1e-4, 0.1)
    np.testing.assert_array_equal(sums.hessian, expected.hessian)
    np.testing.assert_array_equal(sums.column_densities, expected.column_densities)


def test_of_few_tiles_all_are_looked_at_if_any_is_in_reach():
    rng = np.random.default_rng(1)
    left, right = (place + 0.01 * rng.normal(size=(TILE, 3)) for place in ([-2.0, 0.0, 0.0], [2.0, 0.0, 0.0]))
    target = make_mixture("target", np.concatenate([left, right]), None)
    between, at_one = (
        PairLoop(make_mixture("source", place + 1e-3, None), target)
        for place in (left + np.array([2.0, 0.0, 0.0]), left)
    )
    for loop in between, at_one:
        loop._plain[SHARE, TILE:] = np.nan
    assert np.isfinite(between.posterior_sums(np.eye(4), 1e-4, 0.1).row_weights).all()
    assert np.isnan(at_one.posterior_sums(np.eye(4), 1e-4, 0.1).row_weights).all()


def test_the_first_of_far_tiles_behind_a_group_left_out_is_seen():
    line = np.linspace(0.0, 2.0, 2 * GROUP * TILE, endpoint=False)
    target = np.stack([line, 1e-4 * np.sin(1e3 * line), 1e-4 * np.cos(1e3 * line)], axis=1)
    # At the beginning of each tile of the second group in turn.
    for tile in range(GROUP, 2 * GROUP):
        source = np.tile(target[tile * TILE + TILE // 2], (CLUSTER, 1))
        assert seen(source + 1e-5 * np.random.default_rng(tile).normal(size=source.shape), target, 1e-6).all()


@shapes
@pytest.mark.parametrize(("m", "n"), [(3, 3), (CHUNK + 5, 3 * TILE + 1), (500, 2000)])
def test_nearest_distances_match_the_naive_reference(dimension, isotropic, m, n):
    case = Case(m + n, m, n, dimension, isotropic)
    nearest = np.sqrt(case.loop.nearest_sq(lift(case.pose)))
    np.testing.assert_allclose(nearest, reference.nearest_distances(case.y, case.target), rtol=1e-5, atol=1e-6)


def test_a_tile_is_looked_at_for_the_point_of_a_cluster_that_is_farthest_from_any():
    # The last point of the cluster lies on the near tile; the first is nearer to the far one, whose box the cluster's
    # does not touch.
    thin = 1e-3 * np.random.default_rng(2).normal(size=(TILE, 3))
    target = np.concatenate([thin, thin + np.array([1.0, 0.0, 0.0])])
    source = np.stack([np.linspace(0.3, 1.0, CLUSTER), np.zeros(CLUSTER), 1e-3 * np.arange(CLUSTER) ** 2], axis=1)
    loop = PairLoop(make_mixture("source", source, None), make_mixture("target", target, None))
    nearest = np.sqrt(loop.nearest_sq(np.eye(4)))
    np.testing.assert_allclose(nearest, reference.nearest_distances(source, target), rtol=1e-5, atol=1e-6)


def test_component_weights_multiply_the_pair_weights():
    case = Case(3, 20, 30, 3, isotropic=True)
    rng = np.random.default_rng(4)
    u, v = rng.uniform(0.1, 1.0, 20), rng.uniform(0.1, 1.0, 30)
    loop = PairLoop(
        make_mixture("source", case.source, case.source_covariances, u),
        make_mixture("target", case.target, case.target_covariances, v),
    )
    C = reference.pair_weights(case.y, case.B, case.target, case.A, u, v)
    rows = loop.sums(case.pose, *case.sigmas).row_weights
    np.testing.assert_allclose(rows / rows.sum(), C.sum(axis=1) / C.sum(), rtol=2e-6, atol=1e-9)


@pytest.mark.parametrize("isotropic", [True, False])
def test_the_bits_do_not_depend_on_the_number_of_threads(isotropic):
    case = Case(5, 1500, 1300, 3, isotropic)
    most = numba.get_num_threads()
    results = []
    for threads in sorted({1, 2, most} & set(range(1, most + 1))):
        numba.set_num_threads(threads)
        try:
            sums = case.sums()
        finally:
            numba.set_num_threads(most)
        results.append((sums.hessian.tobytes(), sums.gradient.tobytes(), sums.energy, sums.row_weights.tobytes()))
    if len(results) == 1:
        pytest.skip("one core only: nothing to compare")
    assert all(r == results[0] for r in results)


def test_exp2_is_accurate_over_the_whole_range():
    x = np.linspace(-63.9, 0.0, 20_001, dtype=np.float32)
    ours = np.array([exp2_float32(v) for v in x])
    np.testing.assert_allclose(ours, np.exp2(x.astype(np.float64)), rtol=3e-7, atol=0)
    least = exp2_float32(np.float32(-1e30))
    assert least == np.float32(2.0**-64)
    # times the shares of two clouds of a million points it is still a number that costs no more than others
    assert least * np.float32(1e-12) > np.finfo(np.float32).tiny
