"""The paper's weights and σ rules in full: what the loop of Gauss-Newton steps ends at is what exact M-steps end at."""

import numpy as np
import open3d as o3d
import pytest
import reference
from mixtures import random_points_and_covariances, random_pose
from shapes import bumpy, move, turn

from adagmm_o3d import TransformationEstimationForAdaptiveGMM, register_points
from adagmm_o3d.em.m_step import solve_step
from adagmm_o3d.kernels.layout import GRADIENT, HESSIAN, TOTAL_SUMS, TOTAL_WEIGHT
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise

POINTS = 30
MIXTURES = {"nearest": reference.nearest_mixture, "figure2": reference.figure2_mixture}
# No step counts as settled before it comes near what float32 can tell from none.
TO_THE_END = o3d.pipelines.registration.ICPConvergenceCriteria(0.0, 1e-11, 1000)
# The last step is below 2e-6; what is left to go, where convergence is slow, is more.
ATOL = 1e-4


def clouds(dimension, isotropic, n=POINTS):
    """Two small noisy clouds in normalised coordinates, in which the paper's rules are written."""
    rng = np.random.default_rng([dimension, isotropic])
    points = bumpy(rng, n, dimension)
    pose = random_pose(rng, dimension, angle=0.2, distance=0.1)
    _, covariances = random_points_and_covariances(rng, n, dimension, isotropic=isotropic)
    moved = move(points, pose) + 0.05 * rng.normal(size=points.shape)
    mixtures = normalise(
        make_mixture("source", points, covariances), make_mixture("target", moved, turn(covariances, pose))
    )[:2]
    return tuple(m.points[:, :dimension] for m in mixtures) + tuple(
        m.covariances[:, :dimension, :dimension] for m in mixtures
    )


def register(arguments, rule, **kwargs):
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule)
    return register_points(*arguments, estimation_method=method, criteria=TO_THE_END, **kwargs)


def m_step_problem(arguments, rule, transformation):
    """What the reference's M-steps take: the weights at a pose, held, and the mixtures."""
    source, target, source_covariances, target_covariances = arguments
    rotation, translation = transformation[:-1, :-1], transformation[:-1, -1]
    _, B, A = MIXTURES[rule](source, target, source_covariances, target_covariances, rotation, translation)
    C = reference.pair_weights(reference.move(source, rotation, translation), B, target, A)
    return C, source, reference.turn(B, rotation.T), target, A, rotation, translation


def homogeneous(rotation, translation):
    pose = np.eye(len(translation) + 1)
    pose[:-1, :-1], pose[:-1, -1] = rotation, translation
    return pose


@pytest.fixture(params=[(2, True), (2, False), (3, True), (3, False)], ids=["2D", "2D-aniso", "3D", "3D-aniso"])
def arguments(request):
    return clouds(*request.param)


@pytest.mark.parametrize("rule", MIXTURES)
def test_sigma_is_the_rules_at_every_pose_of_the_history(arguments, rule):
    result = register(arguments, rule)
    assert result.iterations > 5
    for sigma, pose in zip(result.sigmas, result.transformations, strict=False):
        y = reference.move(arguments[0], pose[:-1, :-1], pose[:-1, -1])
        expected = {"nearest": reference.sigma_nearest, "figure2": reference.sigma_figure2}[rule](y, arguments[1])
        assert sigma == pytest.approx(expected, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("rule", MIXTURES)
def test_the_end_is_a_fixed_point_of_the_interior_point_m_step(arguments, rule):
    result = register(arguments, rule)
    solution = homogeneous(*reference.exact_m_step(*m_step_problem(arguments, rule, result.transformation)))
    np.testing.assert_allclose(solution, result.transformation, rtol=0, atol=ATOL)
    moved = reference.exact_m_step(*m_step_problem(arguments, rule, result.transformations[0]))
    assert np.abs(homogeneous(*moved) - result.transformations[0]).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dimension", "isotropic", "n", "rule"),
    [
        (2, True, 30, "figure2"),
        (2, False, 20, "nearest"),
        (3, True, 20, "nearest"),
        (3, False, 20, "figure2"),
        (3, False, 10, "nearest"),
    ],
)
def test_the_papers_own_loop_ends_at_the_same_pose(dimension, isotropic, n, rule):
    arguments = clouds(dimension, isotropic, n)
    source, target, source_covariances, target_covariances = arguments
    rotation, translation = np.eye(dimension), np.zeros(dimension)
    for _ in range(40):
        old = homogeneous(rotation, translation)
        rotation, translation, sigma = reference.em_iteration(
            source, target, source_covariances, target_covariances, rotation, translation, mixture=MIXTURES[rule]
        )
        if np.abs(homogeneous(rotation, translation) - old).max() < 1e-5:
            break
    result = register(arguments, rule, init=np.eye(dimension + 1))
    np.testing.assert_allclose(result.transformation, homogeneous(rotation, translation), rtol=0, atol=ATOL)
    assert result.sigma == pytest.approx(sigma, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("rule", ["nearest", "annealed", "figure2"])
def test_the_gradient_of_equation_5_vanishes_at_the_end(arguments, rule):
    # Annealing, here, ends at the σ of its floor; the pairs are weighed there as everywhere.
    result = register(arguments, rule)
    source, target, source_covariances, target_covariances = arguments
    rotation, translation = result.transformation[:-1, :-1], result.transformation[:-1, -1]
    scales = {"figure2": (result.sigma, 1.0)}.get(rule, (result.sigma, result.sigma))
    y = reference.move(source, rotation, translation)
    B = np.linalg.inv(scales[0] * reference.turn(source_covariances, rotation))
    A = np.linalg.inv(scales[1] * target_covariances)
    C = reference.pair_weights(y, B, target, A)
    step = np.linalg.solve(reference.gauss_newton_hessian(C, y, B, target, A), reference.gradient(C, y, B, target, A))
    assert np.linalg.norm(step) < ATOL


def step_of(hessian, gradient, dimension, relaxation=1.0, relative_rmse=1e-3, sigma=0.1):
    total = np.zeros(TOTAL_SUMS)
    total[HESSIAN:GRADIENT], total[GRADIENT:TOTAL_WEIGHT] = hessian[np.triu_indices(6)], gradient
    return solve_step(total, dimension, relaxation=relaxation, relative_rmse=relative_rmse, sigma=sigma)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_step_solves_the_normal_equations_on_the_free_directions(dimension):
    rng = np.random.default_rng(dimension)
    factor = rng.normal(size=(6, 6))
    hessian, gradient = factor @ factor.T + 0.1 * np.eye(6), rng.normal(size=6)
    free = [2, 3, 4] if dimension == 2 else [0, 1, 2, 3, 4, 5]
    step = step_of(hessian, gradient, dimension)
    assert step.determined
    expected = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
    np.testing.assert_allclose(step.delta[free], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(np.delete(step.delta, free), np.zeros(6 - len(free)))
    longer = step_of(hessian, gradient, dimension, relaxation=1.7)
    np.testing.assert_allclose(longer.delta, 1.7 * step.delta, rtol=1e-12, atol=0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_step_is_short_in_standard_deviations_of_the_mixtures(dimension):
    hessian, gradient = np.eye(6), np.full(6, 0.01)
    size = np.linalg.norm(step_of(hessian, gradient, dimension).delta)
    for share, short in ((1.001, True), (0.999, False)):
        step = step_of(hessian, gradient, dimension, relative_rmse=share * size**2 / 0.04, sigma=0.04)
        assert step.short is short


def test_a_direction_that_the_pairs_leave_free_gets_no_step():
    hessian = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 1e-12])
    step = step_of(hessian, np.ones(6), 3)
    assert not step.determined
    np.testing.assert_allclose(
        step.delta, [-1.0, -1.0 / 2.0, -1.0 / 3.0, -1.0 / 4.0, -1.0 / 5.0, 0.0], rtol=1e-12, atol=0
    )


def test_directions_that_are_free_together_get_no_step_apart():
    # No axis of the six is free by itself; of a soft combination one of them is held, whichever way they are turned.
    rng = np.random.default_rng(1)
    for _ in range(20):
        axes = np.linalg.qr(rng.normal(size=(6, 6)))[0]
        hessian = axes @ np.diag([5.0, 4.0, 3.0, 2.0, 1e-13, 1e-13]) @ axes.T
        gradient = axes[:, :4] @ rng.normal(size=4)
        step = step_of(hessian, gradient, 3)
        assert not step.determined and np.count_nonzero(step.delta) == 4
        np.testing.assert_allclose(hessian @ step.delta, -gradient, rtol=0, atol=1e-9)
        assert np.linalg.norm(step.delta) < 20.0 * np.linalg.norm(np.linalg.pinv(hessian, 1e-9) @ gradient)
