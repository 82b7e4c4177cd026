"""The two loops of EM, the compiled one for small clouds and the one in Python, are one algorithm, to rounding."""

from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_points_and_covariances, random_pose
from shapes import body_with_head, move

from adagmm_o3d import TransformationEstimationForAdaptiveGMM, register_points
from adagmm_o3d.em.expectation import LEAST_UNMATCHED, SAMPLED_SIGMA, PosteriorExpectation, posterior_rule
from adagmm_o3d.em.loop import expectation_maximisation
from adagmm_o3d.em.runs import Limits, Start, run_starts
from adagmm_o3d.mixtures.merging import sample
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.options import Criteria
from adagmm_o3d.pairs.cpu_pairs import CUT_BITS, PairLoop
from adagmm_o3d.result import StopReason
from adagmm_o3d.search import refinement, register

CRITERIA = Criteria(relative_rmse=1e-4, max_iteration=200)
LIMITS = Limits(SAMPLED_SIGMA, LEAST_UNMATCHED, CRITERIA.relative_rmse, accelerated=True, bits=CUT_BITS)
SIZE = {2: 90, 3: 150}
shapes = pytest.mark.parametrize(
    ("dimension", "isotropic"), [(2, True), (2, False), (3, True), (3, False)], ids=["2D", "2D a", "3D", "3D a"]
)
relaxations = pytest.mark.parametrize("relaxation", [1.0, 1.6])


def mixtures(seed, dimension, isotropic, n=None):
    """Two normalised mixtures of one shape, a part of the source somewhere else."""
    rng = np.random.default_rng([seed, dimension, isotropic])
    n = n or SIZE[dimension]
    points = body_with_head(rng, n, dimension)
    _, covariances = random_points_and_covariances(rng, n, dimension, isotropic=isotropic)
    # All as vague as each other, so that neither loop leaves out a pair that the other takes.
    covariances /= np.linalg.det(covariances)[:, None, None] ** (1.0 / dimension)
    source = move(points + 0.02 * rng.normal(size=points.shape), random_pose(rng, dimension, angle=0.3, distance=0.2))
    source[: n // 5] = rng.uniform(-1.0, 1.0, (n // 5, dimension))
    made = (make_mixture(name, cloud, covariances) for name, cloud in (("source", source), ("target", points)))
    return normalise(*made)[:2]


def compiled(sides, start, relaxation):
    (end,) = run_starts(
        *(sample(m, len(m)) for m in sides), [start], limits=replace(LIMITS, relaxation=relaxation), level=0
    )
    return end.pose, end.sigma, end.unmatched, len(end.iterations), end.stop_reason


def in_python(sides, start, relaxation):
    dimension = sides[0].dimension
    expectation = PosteriorExpectation(
        PairLoop(*sides),
        posterior_rule(dimension, fastest=start.fastest, floor=SAMPLED_SIGMA),
        start.sigma,
        unmatched=start.unmatched,
        mutuality=0.0,
    )
    criteria = replace(CRITERIA, max_iteration=start.iterations)
    outcome = expectation_maximisation(expectation, start.pose, criteria, dimension, relaxation=relaxation)
    scale = expectation.scale.target
    return outcome.pose, scale, expectation.unmatched, len(outcome.iterations), outcome.stop_reason


def compare(sides, start, relaxation, tolerance):
    ours, theirs = (loop(sides, start, relaxation) for loop in (compiled, in_python))
    np.testing.assert_allclose(ours[0], theirs[0], rtol=0, atol=tolerance)
    np.testing.assert_allclose(ours[1:3], theirs[1:3], rtol=tolerance, atol=0)
    assert ours[3:] == theirs[3:]
    return ours


@shapes
@relaxations
@pytest.mark.parametrize("seed", range(3))
def test_an_iteration_of_both_loops_is_the_same(dimension, isotropic, relaxation, seed):
    sides = mixtures(seed, dimension, isotropic)
    rng = np.random.default_rng(seed)
    for sigma, unmatched, fastest in ((0.3, 0.1, 0.5), (0.02, 0.4, 0.9), (0.004, 0.6, 0.99)):
        pose = np.eye(4)
        pose[:dimension, 3] = 0.1 * rng.normal(size=dimension)
        start = Start(pose, sigma, unmatched, fastest, iterations=1, follow=1.0)
        compare(sides, start, relaxation, 1e-12)


@shapes
@relaxations
def test_both_loops_end_at_the_same_pose_after_as_many_iterations(dimension, isotropic, relaxation):
    # Passes round to float32: where a coordinate falls to the other side, an iteration differs by that, and those after
    # it by what acceleration makes of it.
    for seed in range(3):
        start = Start(np.eye(4), 0.3, 0.1, 0.8, CRITERIA.max_iteration, follow=1.0)
        *_, iterations, reason = compare(mixtures(seed, dimension, isotropic), start, relaxation, 1e-5)
        assert reason is StopReason.CONVERGED and iterations > 10


@pytest.mark.parametrize("loop", [compiled, in_python])
def test_pairs_that_leave_the_pose_undetermined_are_said_to(loop):
    # Two points leave the turn about their line free.
    sides = [m.take(np.array([3, 8])) for m in mixtures(0, 3, True)]
    for most in (1, 200):
        start = Start(np.eye(4), 0.3, 0.1, 0.8, most, follow=1.0)
        pose, *_, reason = loop(sides, start, 1.0)
        assert reason is StopReason.DEGENERATE and np.isfinite(pose).all()


@pytest.mark.parametrize("loop", [compiled, in_python])
def test_clouds_that_do_not_see_each_other_end_it(loop):
    pose = np.eye(4)
    pose[0, 3] = 1e3
    moved, *_, iterations, reason = loop(mixtures(0, 3, False), Start(pose, 0.01, 0.1, 0.8, 50, follow=1.0), 1.0)
    assert reason is StopReason.NO_OVERLAP and iterations == 0
    np.testing.assert_array_equal(moved, pose)


@pytest.fixture
def pair():
    rng = np.random.default_rng(3)
    source = body_with_head(rng, 300, 3)
    truth = random_pose(rng, 3, angle=0.3, distance=0.4)
    return source, move(source + 0.01 * rng.normal(size=source.shape), truth)


@pytest.mark.parametrize("size", [300, 1500])
def test_relaxation_lengthens_the_steps_of_small_clouds_and_of_large_ones(size):
    rng = np.random.default_rng(4)
    source = body_with_head(rng, size, 3)
    target = move(source + 0.03 * rng.normal(size=source.shape), random_pose(rng, 3, angle=0.3, distance=0.4))
    results = [
        register_points(source, target, estimation_method=TransformationEstimationForAdaptiveGMM(relaxation=relaxation))
        for relaxation in (1.0, 1.8)
    ]
    plain, relaxed = (result.transformations for result in results)
    assert (plain != relaxed).any()
    assert all(result.converged for result in results)
    np.testing.assert_allclose(plain[-1], relaxed[-1], rtol=0, atol=1e-3)


@pytest.mark.parametrize("sigma_rule", ["annealed", "nearest", "figure2"])
@pytest.mark.parametrize("size", [300, 1500])
def test_relaxation_saves_iterations_with_the_papers_weights(size, sigma_rule):
    rng = np.random.default_rng(4)
    source = body_with_head(rng, size, 3)
    target = move(source + 0.03 * rng.normal(size=source.shape), random_pose(rng, 3, angle=0.3, distance=0.4))
    options = [TransformationEstimationForAdaptiveGMM(sigma_rule=sigma_rule, relaxation=r) for r in (1.0, 1.5)]
    plain, relaxed = (register_points(source, target, estimation_method=option) for option in options)
    assert plain.converged and relaxed.converged
    assert relaxed.iterations < plain.iterations
    # Each stops where a step is short beside the noise, 0.03, on its own way.
    np.testing.assert_allclose(plain.transformation, relaxed.transformation, rtol=0, atol=1e-2)


@pytest.mark.parametrize("size", [300, 1500])
def test_iterations_before_the_last_level_are_told_at_once_when_the_search_has_ended(size, monkeypatch):
    rng = np.random.default_rng(5)
    source = body_with_head(rng, size, 3)
    target = move(source + 0.01 * rng.normal(size=source.shape), random_pose(rng, 3, angle=0.3, distance=0.4))
    levels, found = [], []
    refine = register.refine

    def recorded(*arguments, **options):
        found.append(list(levels))
        return refine(*arguments, **options)

    monkeypatch.setattr(register, "refine", recorded)
    register_points(source, target, callback_after_iteration=lambda step: levels.append(step["scale_index"]))
    assert len(found) == 1 and found[0] and max(found[0]) < refinement.LEVEL
    assert levels[: len(found[0])] == found[0] and set(levels[len(found[0]) :]) == {refinement.LEVEL}


def test_iterations_of_small_clouds_are_told_as_they_happen(pair, monkeypatch):
    events = []
    run = refinement.run_starts

    def recorded(*sides, **options):
        events.append("run")
        return run(*sides, **options)

    monkeypatch.setattr(refinement, "run_starts", recorded)
    quiet = register_points(*pair)
    assert events == ["run"]
    events.clear()

    def hear(step):
        if step["scale_index"] == refinement.LEVEL:
            events.append("heard")

    told = register_points(*pair, callback_after_iteration=hear)
    assert len(events) > 10 and events == ["run", "heard"] * (len(events) // 2)
    for name in ("transformation", "transformations", "sigmas", "energies"):
        np.testing.assert_array_equal(getattr(told, name), getattr(quiet, name), err_msg=name)
    assert (told.iterations, told.stop_reason) == (quiet.iterations, quiet.stop_reason)


def test_relative_fitness_is_not_read(pair):
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria
    results = [
        register_points(*pair, criteria=criteria(relative_fitness, 1e-3, 200)) for relative_fitness in (1e-12, 0.5)
    ]
    np.testing.assert_array_equal(*(result.transformations for result in results))
