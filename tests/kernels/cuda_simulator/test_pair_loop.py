"""The CUDA kernels in Numba's simulator: against the naive reference and the CPU, at the edges of every block."""

import numpy as np
import pytest
import reference
from cuda_cases import (
    Case,
    bits,
    check_against_the_cpu,
    check_nearest,
    check_posterior_sums,
    check_same,
    check_sums,
    spoil,
)

from adagmm_o3d.em.expectation import AdaptiveExpectation, PosteriorExpectation, posterior_rule
from adagmm_o3d.em.loop import expectation_maximisation
from adagmm_o3d.em.sigma_rules import NearestDistance
from adagmm_o3d.kernels.cuda import adaptive_rows
from adagmm_o3d.kernels.cuda.front_end import TILE
from adagmm_o3d.kernels.cuda.tiles import gap_sq
from adagmm_o3d.options import Criteria
from adagmm_o3d.pairs import cuda_pairs

SHAPES = [("2D", 2, True), ("2D anisotropic", 2, False), ("3D", 3, True), ("3D anisotropic", 3, False)]
shapes = pytest.mark.parametrize(("dimension", "isotropic"), [s[1:] for s in SHAPES], ids=[s[0] for s in SHAPES])
# Below, at and above a tile; more tiles than are summed in float32 at a time; more than a block tests at a time.
SIZES = [(3, TILE - 1), (TILE, TILE), (TILE + 1, 2 * TILE + 1), (2 * TILE - 1, (adaptive_rows.FLUSH + 1) * TILE + 3)]
SIZES += [(3, TILE * TILE + 1), (TILE * TILE + 1, 3)]
sizes = pytest.mark.parametrize(("m", "n"), SIZES)


@pytest.fixture(autouse=True)
def few_blocks(monkeypatch):
    """One block does all it can by itself, unless a test wants shares."""
    monkeypatch.setattr(cuda_pairs, "WANTED_BLOCKS", 1)


@shapes
@sizes
def test_sums_match_the_naive_reference(dimension, isotropic, m, n):
    check_sums(Case(7 * m + n, m, n, dimension, isotropic))


@shapes
@pytest.mark.parametrize(("m", "n", "mutuality"), [(*size, 0.5) for size in SIZES] + [(TILE + 1, TILE - 1, 0.0)])
def test_posterior_sums_match_the_naive_reference(dimension, isotropic, m, n, mutuality):
    check_posterior_sums(Case(11 * m + n, m, n, dimension, isotropic), mutuality)


@shapes
@pytest.mark.parametrize(("m", "n", "mutuality"), [(TILE + 1, 2 * TILE + 1, 0.5), (2 * TILE - 1, TILE, 0.0)])
def test_posterior_sums_with_colours_match_the_naive_reference(dimension, isotropic, m, n, mutuality):
    check_posterior_sums(Case(13 * m + n, m, n, dimension, isotropic), mutuality, coloured=True)


@shapes
@sizes
def test_nearest_distances_match_the_naive_reference(dimension, isotropic, m, n):
    check_nearest(Case(m + n, m, n, dimension, isotropic))


def test_every_source_point_looks_as_far_as_it_has_to():
    # One block of source points, each amid a tile of target points of its own; the first sits on one of them.
    case = Case(2, TILE, TILE * TILE, 3, isotropic=True, apart=1.0)
    case.source[:] = 0.0
    case.source[:, 0] = 10.0 * np.arange(TILE)
    case.target[:] = np.repeat(case.source, TILE, axis=0) + 0.1 * np.random.default_rng(0).normal(size=(TILE * TILE, 3))
    case.target[0] = case.source[0]
    case.source[:, 1] += 1e-3 * np.arange(TILE) ** 2  # not on one line
    case.mixtures = case.mixtures_of_the_clouds()
    case.y = case.source
    check_nearest(case)


@shapes
def test_the_cpu_gives_the_same_sums(dimension, isotropic):
    check_against_the_cpu(Case(3, 2 * TILE + 1, 3 * TILE, dimension, isotropic))


@pytest.mark.parametrize("isotropic", [True, False])
def test_shares_of_the_other_side_add_up_to_the_same(isotropic, monkeypatch):
    case = Case(4, TILE + 3, 3 * TILE + 1, 3, isotropic)

    def passes():
        loop = case.cuda_loop()
        posterior = loop.posterior_sums(case.lifted, 0.2, 0.05, 0.5)
        return loop.sums(case.lifted, *case.sigmas), posterior, posterior.column_densities, loop.nearest_sq(case.lifted)

    alone = passes()
    monkeypatch.setattr(cuda_pairs, "WANTED_BLOCKS", 1000)
    shared = passes()
    check_same(shared[0], alone[0])
    check_same(shared[1], alone[1])
    np.testing.assert_allclose(shared[2], alone[2], rtol=2e-6, atol=1e-9)
    np.testing.assert_array_equal(shared[3], alone[3])


def test_the_bits_are_the_same_every_time():
    case = Case(5, TILE + 3, 3 * TILE + 1, 3, isotropic=False)
    assert bits(case) == bits(case)


@shapes
def test_far_tiles_are_left_out(dimension, isotropic):
    # Two heaps far apart on either side: a tile of one has nothing to do with those of the other.
    case = Case(6, 2 * TILE, 4 * TILE, dimension, isotropic, sigmas=(1e-3, 1e-3), radius=0.02, apart=50.0)
    loop = case.cuda_loop()
    C = reference.pair_weights(case.y, case.B, case.target, case.A) / case.unit()
    np.testing.assert_allclose(loop.sums(case.lifted, *case.sigmas).weight, C.sum(), rtol=1e-5, atol=0)
    before = vectors(loop.posterior_sums(case.lifted, 1e-3, 0.05))
    nearest = loop.nearest_sq(case.lifted)

    # Spoil every tile of the heap at 50 that a source tile near 0 could touch; only its own half may notice.
    heap = case.target[loop._target.order][:, 0] > 25.0
    far = heap.reshape(-1, TILE).all(axis=1)
    assert far.sum() == 2
    for tiles in (loop._precisions[1], loop._covariances[1]):
        host = tiles.copy_to_host()
        host[far] = np.nan
        tiles.copy_to_device(host)
    near_rows = case.source[:, 0] < 25.0
    near_columns = case.target[:, 0] < 25.0
    weights = loop.sums(case.lifted, *case.sigmas).row_weights
    np.testing.assert_allclose(weights[near_rows], C.sum(axis=1)[near_rows], rtol=1e-5, atol=0)
    posteriors, columns = vectors(loop.posterior_sums(case.lifted, 1e-3, 0.05))
    np.testing.assert_array_equal(posteriors[near_rows], before[0][near_rows])
    np.testing.assert_array_equal(columns[near_columns], before[1][near_columns])
    np.testing.assert_array_equal(loop.nearest_sq(case.lifted)[near_rows], nearest[near_rows])
    assert np.isnan(weights[~near_rows]).all()


def test_vectors_on_the_device_do_not_change_when_their_buffers_are_used_again():
    case = Case(8, TILE + 1, TILE + 2, 3, isotropic=True)
    loop = case.cuda_loop()
    read_at_once = [v for s in (0.1, 0.2, 0.3) for v in vectors(loop.posterior_sums(case.lifted, s, 0.05, 0.5))]
    spoil(loop)
    held = [loop.posterior_sums(case.lifted, s, 0.05, 0.5) for s in (0.1, 0.2, 0.3)]
    for late, early in zip((v for sums in held for v in vectors(sums)), read_at_once, strict=True):
        np.testing.assert_array_equal(late, early)


def test_the_target_is_asked_only_when_somebody_wants_to_know(monkeypatch):
    case = Case(10, TILE + 1, TILE + 2, 3, isotropic=False)
    expected = case.cpu_loop().posterior_sums(case.lifted, 0.2, 0.05)
    loop, asked = case.cuda_loop(), []
    launch = loop.launch_convolved_columns
    monkeypatch.setattr(
        loop, "launch_convolved_columns", lambda sigma, hues: (asked.append(sigma), launch(sigma, hues))
    )
    sums = loop.posterior_sums(case.lifted, 0.2, 0.05)
    check_same(sums, expected)
    assert asked == []
    loop.sums(np.eye(4), 0.7, 0.7)  # the source is elsewhere when the answer is wanted
    np.testing.assert_allclose(sums.column_densities, expected.column_densities, rtol=2e-6, atol=1e-9)
    assert asked == [0.2]
    # weights that need the answer get it at once, and only once
    sums = loop.posterior_sums(case.lifted, 0.1, 0.05, 0.5)
    assert sums.column_densities.any() and asked == [0.2, 0.1]


def vectors(sums):
    return sums.row_weights, sums.column_densities


def posterior(loop):
    return PosteriorExpectation(loop, posterior_rule(3), 0.3, unmatched=0.3, mutuality=0.5)


def adaptive(loop):
    return AdaptiveExpectation(loop, NearestDistance(3), np.eye(4))


@pytest.mark.parametrize("expectation", [posterior, adaptive])
def test_em_arrives_where_it_does_on_the_cpu(expectation):
    case = Case(9, 3 * TILE, 3 * TILE, 3, isotropic=False)
    outcomes = [
        expectation_maximisation(expectation(loop), np.eye(4), Criteria(1e-6, 3), 3)
        for loop in (case.cpu_loop(), case.cuda_loop())
    ]
    assert len(outcomes[1].iterations) == len(outcomes[0].iterations)
    np.testing.assert_allclose(outcomes[1].pose, outcomes[0].pose, rtol=1e-5, atol=1e-6)


def test_the_gap_of_two_boxes_is_that_of_the_naive_formula():
    rng = np.random.default_rng(0)
    low = rng.uniform(-2.0, 2.0, (2, 50, 3))
    boxes = np.concatenate([low, low + rng.uniform(0.0, 1.0, low.shape)], axis=2).astype(np.float32)
    apart = np.maximum(boxes[1, :, :3] - boxes[0, :, 3:], boxes[0, :, :3] - boxes[1, :, 3:]).astype(np.float64)
    expected = (np.maximum(apart, 0.0) ** 2).sum(axis=1)
    assert (expected == 0.0).any() and (expected > 1.0).any()
    np.testing.assert_allclose([gap_sq(boxes[0], i, boxes[1], i) for i in range(50)], expected, rtol=1e-5, atol=1e-7)
