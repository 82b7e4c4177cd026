"""The naive reference against the paper's formulas written out pair by pair, differences and closed forms."""

import math

import numpy as np
import pytest
import reference
from scipy.linalg import sqrtm
from scipy.stats import multivariate_normal, special_ortho_group

CASES = [(2, "isotropic"), (2, "anisotropic"), (3, "isotropic"), (3, "anisotropic")]
MATCHING = pytest.mark.parametrize("problem", CASES, indirect=True, ids=lambda case: f"{case[0]}D-{case[1]}")


def mixture(rng, count, dimension, kind):
    points = rng.normal(size=(count, dimension))
    if kind == "isotropic":
        covariances = rng.uniform(0.05, 0.5, size=count)[:, None, None] * np.eye(dimension)
    else:
        root = rng.normal(size=(count, dimension, dimension))
        covariances = 0.2 * root @ root.transpose(0, 2, 1) + 0.02 * np.eye(dimension)
    return points, covariances


class Problem:
    """Two mixtures of unequal size with nothing in correspondence, and a pose far from the best one."""

    def __init__(self, dimension, kind, sizes=(9, 11)):
        rng = np.random.default_rng([dimension, CASES.index((dimension, kind))])
        self.dimension, self.kind = dimension, kind
        self.y0, self.source_covariances = mixture(rng, sizes[0], dimension, kind)
        self.x, self.target_covariances = mixture(rng, sizes[1], dimension, kind)
        self.rotation = special_ortho_group.rvs(dimension, random_state=rng)
        self.translation = 0.3 * rng.normal(size=dimension)
        self.B0, self.A = np.linalg.inv(self.source_covariances), np.linalg.inv(self.target_covariances)
        self.y = reference.move(self.y0, self.rotation, self.translation)
        self.B = reference.turn(self.B0, self.rotation)
        self.source_weights, self.target_weights = rng.uniform(0.5, 2.0, sizes[0]), rng.uniform(0.5, 2.0, sizes[1])
        self.C = reference.pair_weights(self.y, self.B, self.x, self.A)

    def pairs(self):
        return (self.C, self.y, self.B, self.x, self.A)

    def at(self, rotation, translation):
        return self.C, reference.move(self.y0, rotation, translation), reference.turn(self.B0, rotation), self.x, self.A


@pytest.fixture
def problem(request):
    return Problem(*request.param)


@MATCHING
def test_weights_are_the_papers_densities_at_both_points(problem):
    p, normal = problem, multivariate_normal.pdf
    moved = reference.turn(p.source_covariances, p.rotation)
    for m, y in enumerate(p.y):
        for n, x in enumerate(p.x):
            gx, gy = p.target_covariances[n], moved[m]
            # P(τ, x, y) of Eq. 2 at τ = y and at τ = x
            paper = normal(y, x, gx) * normal(y, y, gy) + normal(x, x, gx) * normal(x, y, gy)
            assert p.C[m, n] == pytest.approx(paper * (2.0 * math.pi) ** p.dimension, rel=1e-10, abs=1e-300)


@MATCHING
def test_component_weights_multiply(problem):
    p = problem
    weighted = reference.pair_weights(p.y, p.B, p.x, p.A, p.source_weights, p.target_weights)
    np.testing.assert_allclose(weighted, np.outer(p.source_weights, p.target_weights) * p.C, rtol=1e-14, atol=0.0)


@MATCHING
def test_pair_sums_are_the_sums_over_pairs(problem):
    p = problem
    sums = reference.pair_sums(p.y, p.B, p.x, p.A, p.source_weights, p.target_weights)
    upper = [(i, j) for i in range(p.dimension) for j in range(i, p.dimension)]
    for m in range(len(p.y)):
        weight = energy = 0.0
        precision = scatter = np.zeros((p.dimension, p.dimension))
        target_pull = offset = pull = np.zeros(p.dimension)
        turning = np.zeros(1 if p.dimension == 2 else 3)
        for n in range(len(p.x)):
            c = p.C[m, n] * p.source_weights[m] * p.target_weights[n]
            d = p.y[m] - p.x[n]
            ad, bd = p.A[n] @ d, p.B[m] @ d
            weight += c
            energy += c * (d @ ad + d @ bd)
            precision = precision + c * p.A[n]
            target_pull = target_pull + c * ad
            offset = offset + c * d
            pull = pull + c * (ad + bd)
            turning = turning + c * (d[0] * bd[1] - d[1] * bd[0] if p.dimension == 2 else np.cross(d, bd))
            scatter = scatter + c * np.outer(d, d)
        close = {"rtol": 1e-11, "atol": 1e-11}
        np.testing.assert_allclose(sums.weight[m], weight, **close)
        np.testing.assert_allclose(sums.energy[m], energy, **close)
        np.testing.assert_allclose(sums.precision[m], [precision[i, j] for i, j in upper], **close)
        np.testing.assert_allclose(sums.target_pull[m], target_pull, **close)
        np.testing.assert_allclose(sums.offset[m], offset, **close)
        np.testing.assert_allclose(sums.pull[m], pull, **close)
        np.testing.assert_allclose(sums.turn[m], turning, **close)
        np.testing.assert_allclose(sums.scatter[m], [scatter[i, j] for i, j in upper], **close)


@pytest.mark.parametrize("kind", ["isotropic", "anisotropic"])
def test_rows_of_the_plane_are_rows_of_space_at_z_0(kind):
    p = Problem(2, kind)

    def lift_points(points):
        return np.column_stack([points, np.zeros(len(points))])

    def lift(matrices):
        lifted = np.tile(np.eye(3), (len(matrices), 1, 1))
        lifted[:, :2, :2] = matrices
        return lifted

    plane = reference.pair_sums(p.y, p.B, p.x, p.A).rows()
    space = reference.pair_sums(lift_points(p.y), lift(p.B), lift_points(p.x), lift(p.A)).rows()
    space[:, 7] = 0.0  # Σ C A_zz: the plane has no such entry
    np.testing.assert_allclose(plane, space, rtol=1e-12, atol=1e-12)


@MATCHING
def test_energy_is_the_sum_of_the_rows(problem):
    p = problem
    total = reference.pair_sums(p.y, p.B, p.x, p.A).energy.sum()
    assert reference.energy(*p.pairs()) == pytest.approx(total, rel=1e-12, abs=0.0)
    at_pose = reference.energy_at(p.C, p.y0, p.B0, p.x, p.A, p.rotation, p.translation)
    assert at_pose == pytest.approx(total, rel=1e-12, abs=0.0)


@MATCHING
def test_gradient_matches_differences(problem):
    p = problem
    exact = reference.gradient(*p.pairs())
    differences = reference.gradient_by_differences(p.C, p.y0, p.B0, p.x, p.A, p.rotation, p.translation)
    np.testing.assert_allclose(exact, differences, rtol=1e-6, atol=1e-7 * np.abs(exact).max())


@MATCHING
def test_gradient_follows_from_the_sums(problem):
    p = problem
    sums = reference.pair_sums(p.y, p.B, p.x, p.A)
    if p.dimension == 2:
        lever = (p.y[:, 0] * sums.pull[:, 1] - p.y[:, 1] * sums.pull[:, 0])[:, None]
    else:
        lever = np.cross(p.y, sums.pull)
    from_sums = 2.0 * np.concatenate([(lever - sums.turn).sum(axis=0), sums.pull.sum(axis=0)])
    exact = reference.gradient(*p.pairs())
    np.testing.assert_allclose(from_sums, exact, rtol=1e-11, atol=1e-11 * np.abs(exact).max())
    from_parts = sums.target_pull + np.einsum("mij,mj->mi", p.B, sums.offset)
    np.testing.assert_allclose(from_parts, sums.pull, rtol=1e-11, atol=1e-11 * np.abs(sums.pull).max())


@MATCHING
def test_the_turning_term_vanishes_for_isotropic_sources_only(problem):
    p = problem
    sums = reference.pair_sums(p.y, p.B, p.x, p.A)
    size = np.abs(sums.turn).max() / sums.energy.max()
    assert size < 1e-14 if p.kind == "isotropic" else size > 1e-3


@MATCHING
def test_gauss_newton_hessian_is_that_of_the_residuals(problem):
    p = problem
    roots_a, roots_b = (np.array([sqrtm(s).real for s in stack]) for stack in (p.A, p.B0))
    root_c = np.sqrt(p.C)[..., None]

    def residuals(delta):
        rotation, translation = reference.apply_tangent(delta, p.rotation, p.translation)
        d = reference.move(p.y0, rotation, translation)[:, None] - p.x[None]
        r = root_c * np.einsum("nij,mnj->mni", roots_a, d)
        s = root_c * np.einsum("mij,mnj->mni", roots_b, d @ rotation)
        return np.concatenate([r.ravel(), s.ravel()])

    size = 3 if p.dimension == 2 else 6
    jacobian = np.array([residuals(e) - residuals(-e) for e in 1e-6 * np.eye(size)]).T / 2e-6
    H = reference.gauss_newton_hessian(*p.pairs())
    np.testing.assert_allclose(H, 2.0 * jacobian.T @ jacobian, rtol=1e-6, atol=1e-7 * np.abs(H).max())
    np.testing.assert_allclose(
        reference.gradient(*p.pairs()), 2.0 * jacobian.T @ residuals(np.zeros(size)), rtol=1e-6, atol=1e-7 * H.max()
    )


@MATCHING
def test_both_hessians_are_the_true_one_where_the_residuals_vanish(problem):
    p = problem
    x = p.y.copy()
    C, A = np.diag(p.source_weights), p.A[: len(x)]
    H = reference.gauss_newton_hessian(C, p.y, p.B, x, A)
    np.testing.assert_allclose(reference.gauss_newton_hessian(C, p.y, p.B, x, A, turning=False), H, rtol=1e-12, atol=0)

    def gradient(delta):
        rotation, translation = reference.apply_tangent(delta, p.rotation, p.translation)
        return reference.gradient(C, reference.move(p.y0, rotation, translation), reference.turn(p.B0, rotation), x, A)

    true = np.array([gradient(e) - gradient(-e) for e in 1e-6 * np.eye(len(H))]) / 2e-6
    np.testing.assert_allclose(H, true, rtol=1e-6, atol=1e-7 * np.abs(H).max())


@MATCHING
def test_exact_m_step_is_a_minimum_over_rotations(problem):
    p = problem
    rotation, translation = reference.exact_m_step(p.C, p.y0, p.B0, p.x, p.A, p.rotation, p.translation)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(p.dimension), rtol=0.0, atol=1e-9)
    assert np.linalg.det(rotation) > 0.0
    before = reference.energy(*p.pairs())
    after = reference.energy(*p.at(rotation, translation))
    assert after < 0.99 * before
    slope = reference.gradient(*p.at(rotation, translation))
    np.testing.assert_allclose(slope, 0.0, rtol=0.0, atol=1e-6 * np.abs(reference.gradient(*p.pairs())).max())
    rng = np.random.default_rng(5)
    for _ in range(20):
        delta = 10.0 ** rng.uniform(-4, -1) * rng.normal(size=len(slope))
        nearby = reference.apply_tangent(delta, rotation, translation)
        assert reference.energy(*p.at(*nearby)) >= after


@MATCHING
@pytest.mark.parametrize("turning", [True, False])
def test_exact_m_step_agrees_with_the_one_on_the_manifold(problem, turning):
    p = problem
    start = (p.C, p.y0, p.B0, p.x, p.A, p.rotation, p.translation)
    rotation, translation = reference.exact_m_step(*start)
    on_manifold = reference.gauss_newton_m_step(*start, turning=turning)
    np.testing.assert_allclose(on_manifold[0], rotation, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(on_manifold[1], translation, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("dimension", [2, 3])
def test_exact_m_step_of_isotropic_mixtures_is_weighted_procrustes(dimension):
    p = Problem(dimension, "isotropic")
    weights = p.C * (p.B0[:, 0, 0][:, None] + p.A[:, 0, 0][None, :])
    mean_y = weights.sum(axis=1) @ p.y0 / weights.sum()
    mean_x = weights.sum(axis=0) @ p.x / weights.sum()
    u, _, vt = np.linalg.svd((p.x - mean_x).T @ weights.T @ (p.y0 - mean_y))
    u[:, -1] *= np.linalg.det(u @ vt)
    rotation, translation = reference.exact_m_step(p.C, p.y0, p.B0, p.x, p.A, p.rotation, p.translation)
    np.testing.assert_allclose(rotation, u @ vt, rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(translation, mean_x - u @ vt @ mean_y, rtol=0.0, atol=1e-7)


def test_sigma_rules_on_a_case_done_by_hand():
    x = np.array([[0.0, 0.0], [4.0, 0.0]])
    y = np.array([[0.0, 3.0], [4.0, 1.0]])
    assert reference.sigma_figure2(y, x) == pytest.approx(2.0, rel=1e-15)
    assert reference.sigma_nearest(y, x) == pytest.approx(2.5, rel=1e-15)


@MATCHING
def test_figure2_scales_the_source_alone_and_the_nearest_rule_both(problem):
    p = problem
    args = (p.y0, p.x, p.source_covariances, p.target_covariances, p.rotation, p.translation)
    literal, B, A = reference.figure2_mixture(*args)
    np.testing.assert_allclose(B, p.B / literal, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(A, p.A, rtol=1e-12, atol=0.0)
    sigma, B, A = reference.nearest_mixture(*args)
    np.testing.assert_allclose(B, p.B / sigma, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(A, p.A / sigma, rtol=1e-9, atol=1e-12)
    assert literal == pytest.approx(reference.sigma_figure2(p.y, p.x), rel=1e-15)
    assert sigma == pytest.approx(reference.sigma_nearest(p.y, p.x), rel=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [2, 3])
def test_em_iterations_find_a_small_motion(dimension):
    rng = np.random.default_rng(11)
    x, root = rng.normal(size=(20, dimension)), rng.normal(size=(20, dimension, dimension))
    covariances = np.eye(dimension) + 0.3 * root @ root.transpose(0, 2, 1)
    tangent = 0.1 * rng.normal(size=3 if dimension == 2 else 6)
    true = reference.apply_tangent(tangent, np.eye(dimension), np.zeros(dimension))
    y0, source_covariances = (x - true[1]) @ true[0], reference.turn(covariances, true[0].T)
    rotation, translation = np.eye(dimension), np.zeros(dimension)
    for _ in range(10):
        rotation, translation, sigma = reference.em_iteration(
            y0, x, source_covariances, covariances, rotation, translation
        )
        if sigma < 1e-6:
            break
    np.testing.assert_allclose(rotation, true[0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(translation, true[1], rtol=0.0, atol=1e-9)
