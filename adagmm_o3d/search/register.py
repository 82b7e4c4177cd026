"""Registration of two mixtures: where to start, which end of a search to believe, and its refinement on all points."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.expectation import AdaptiveExpectation
from adagmm_o3d.em.loop import Outcome, expectation_maximisation
from adagmm_o3d.em.m_step import ANY_AXIS, turned_about
from adagmm_o3d.em.runs import End, inverse_end, inverse_of, pose_distance
from adagmm_o3d.em.sigma_rules import Annealed, FigureTwo, NearestDistance, SigmaRule
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import project_to_rotation, se_exp, se_log, split
from adagmm_o3d.mixtures.condensing import Condensed
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.normalisation import Normalisation, normalise
from adagmm_o3d.options import INIT_TOLERANCE, Callback, Criteria, TransformationEstimationForAdaptiveGMM
from adagmm_o3d.pairs.device import make_pair_loop
from adagmm_o3d.result import Deferred, Iteration, PointRegistrationResult, PoseUncertainty, StopReason, Verdict
from adagmm_o3d.search.find import find
from adagmm_o3d.search.levels import Levels
from adagmm_o3d.search.refinement import refine
from adagmm_o3d.search.rotations import APART_AMBIGUOUS
from adagmm_o3d.search.schedule import SCHEDULE
from adagmm_o3d.search.staying import fit_to_stay_at
from adagmm_o3d.trust import verdict
from adagmm_o3d.trust.color_support import color_support
from adagmm_o3d.trust.conclusion import Answers, conclude, lower
from adagmm_o3d.trust.judge import JUDGED, Judge, holds
from adagmm_o3d.trust.partners import no_partners, partners_at
from adagmm_o3d.trust.pose_covariance import Fit, uncertainty_out
from adagmm_o3d.trust.upright import held_by_gravity

# No more than a third of `max_iteration` is reported of the search.
SEARCHING = 3
# The refinement begins at a pose and σ of so many digits, so that rounding on the way there, which units and the order
# of the clouds change, makes no difference to it.
DIGITS = 9
# A start may tilt gravity by so many degrees, which a rotation of few digits does.
MOST_TILT = 0.5
# Radii that differ by no more of themselves are the same but for rounding.
SAME_RADIUS = 1e-9
# The paper's wide mixtures converge slowly: their steps are short long before the end.
SLOW = 0.01


@dataclass(frozen=True)
class _Task:
    """What is asked for: two normalised mixtures to register, and how.

    given : (4, 4) the start between them, or None.   everywhere : whether nothing is known of the pose.   axis : (3,)
    the only one to turn about, or zero.   seen_from : the viewpoints of both.
    """

    moving: Mixture
    fixed: Mixture
    normalisation: Normalisation
    given: Array | None
    everywhere: bool
    axis: Array
    seen_from: tuple[Array | None, Array | None]
    method: TransformationEstimationForAdaptiveGMM
    limits: Criteria
    device: str
    observe: Callable[[Iteration], None] | None


def _unknown() -> PoseUncertainty:
    """Of a pose that the paper's own rules found, or that no pair speaks for."""
    return PoseUncertainty(None, ())


def _none() -> None:
    """Of a pose that no pair speaks for."""


@dataclass(frozen=True)
class _Ended:
    """Where it has ended, from which start, both from `moving` to `fixed`; weigh, assess : see `Answers`.

    ambiguous : whether the search found another pose as good.   fit : that of the last level, if there was one.
    """

    start: Array
    outcome: Outcome
    weigh: Callable[[], Verdict | None]
    assess: Callable[[], PoseUncertainty] = _unknown
    ambiguous: bool = False
    fit: Fit | None = None


def register_mixtures(
    moving: Mixture,
    fixed: Mixture,
    init: ArrayLike | str | None,
    method: TransformationEstimationForAdaptiveGMM,
    limits: Criteria,
    device: str,
    callback: Callback | None,
    viewpoints: tuple[Array | None, Array | None] = (None, None),
) -> PointRegistrationResult:
    """Register the mixtures as they came through the door, wherever they lie; see `register_points`."""
    dimension = moving.dimension
    moving, fixed, normalisation = normalise(moving, fixed)
    observe = _observer(callback, normalisation, dimension)
    if isinstance(init, str) and init != "global":
        raise InputError(f"init: expected a pose or 'global', got {init!r}")
    everywhere = isinstance(init, str)
    given = None if init is None or everywhere else _start_pose(init, normalisation, dimension)
    axis = ANY_AXIS if method.gravity is None else np.array(method.gravity)
    if method.gravity is not None:
        given = _check_gravity(axis, given, dimension)
    if limits.max_iteration == 0:
        return _stay(moving, fixed, init, given, normalisation)
    seen_from = normalisation.points_in(*viewpoints)
    task = _Task(moving, fixed, normalisation, given, everywhere, axis, seen_from, method, limits, device, observe)
    ended = _by_posteriors(task) if method.sigma_rule == "posterior" else _by_the_papers_weights(task)
    find_partners = partial(no_partners, moving)
    compare_colors: Callable[[], Array] | None = None
    fit = ended.fit
    if ended.outcome.stop_reason is not StopReason.NO_OVERLAP:
        if fit is not None and fit.colour is not None:
            compare_colors = partial(color_support, moving, fixed, fit, device)
        find_partners = partial(partners_at, moving, fixed, ended.outcome.pose)
    return conclude(
        ended.start,
        ended.outcome,
        normalisation,
        moving,
        fixed,
        Answers(find_partners, ended.assess, ended.weigh, compare_colors),
        ambiguous=ended.ambiguous,
        colour=None if fit is None else fit.colour,
    )


def _by_posteriors(task: _Task) -> _Ended:
    """The search, and its end carried to convergence."""
    normalisation, method, limits, observe = task.normalisation, task.method, task.limits, task.observe
    clouds = Condensed(task.moving), Condensed(task.fixed)
    turned = comes_second(task.moving, task.fixed)
    seen_from = task.seen_from[::-1] if turned else task.seen_from
    sides = clouds[0].searched, clouds[1].searched
    searched = Levels(*(sides[::-1] if turned else sides), SCHEDULE, task.axis)
    judge = Deferred(partial(_judge_of, searched, seen_from))
    identity, given = normalisation.pose_in(np.eye(4)), task.given
    if given is not None and np.allclose(given, identity, rtol=0, atol=1e-9):
        given = None
    given_there = inverse_of(given) if turned and given is not None else given
    identity_there = None if method.start == "centroids" else inverse_of(identity) if turned else identity
    found = find(
        searched,
        given=given_there,
        identity=identity_there,
        centroids=method.start != "init",
        everywhere=task.everywhere,
        search=method.search,
        judge=judge,
        viewpoints=seen_from,
    )
    # Either direction of a pair is one problem for the refinement, too, whose pairs do not look alike from both clouds.
    # It goes by the clouds' radii, which points given several times do not change. With colours it is the caller's:
    # what is learnt of them belongs to it.
    dense, coloured = any(cloud.dense for cloud in clouds), task.moving.colours is not None
    inverted = not coloured and refines_inverse(normalisation, dense=dense, turned=turned)
    best, limits = _within(limits, found.end if inverted == turned else inverse_end(found.end))
    best = best._replace(pose=se_exp(np.round(se_log(best.pose), DIGITS)), sigma=float(f"{best.sigma:.{DIGITS}g}"))
    if observe is not None and inverted:
        observe = _of_inverse(observe)
    if observe is not None:
        for iteration in best.iterations:
            observe(iteration)
    levels = searched if inverted == turned else Levels(searched.target, searched.source, SCHEDULE, task.axis)
    refined = refine(
        levels,
        clouds[::-1] if inverted else clouds,
        best,
        limits,
        device=task.device,
        mutuality=_mutuality(method, levels),
        relaxation=method.relaxation,
        observe=observe,
    )
    outcome, start, fit, ambiguous = refined.outcome, best.start, refined.fit, found.ambiguous
    forward = inverted == turned
    at = outcome.pose if forward else inverse_of(outcome.pose)
    if not found.certain and outcome.stop_reason is not StopReason.NO_OVERLAP:
        stayed = _stayed(task, judge, searched, given_there, identity_there, at)
        if stayed is not None:
            rivalled = pose_distance(stayed, at) > APART_AMBIGUOUS and holds(judge().held(at))
            ambiguous, at = ambiguous or rivalled, stayed
            outcome = _moved_to(outcome, stayed if forward else inverse_of(stayed), task.limits, observe)
            fit = replace(fit, pose=outcome.pose)
    assess: Callable[[], PoseUncertainty] = _unknown
    weigh: Callable[[], Verdict | None] = _none
    if outcome.stop_reason is not StopReason.NO_OVERLAP:
        mixtures = refined.pairs, refined.source, refined.target
        assess = partial(uncertainty_out, *mixtures, fit, normalisation, inverse=inverted)
        if method.gravity is not None:
            assess = partial(_assess_upright, assess, task.axis)
        weigh = partial(_weigh, judge, at, turned, _gravity(task))
    if inverted:
        outcome, start = _inverse_outcome(outcome), inverse_of(start)
    return _Ended(start, outcome, weigh, assess, ambiguous, fit)


def _stayed(
    task: _Task, judge: Deferred[Judge], searched: Levels, given: Array | None, identity: Array | None, end: Array
) -> Array | None:
    """(4, 4) where the start stays rather than go to `end`, all of it as the search has it; None where it does not.

    What else speaks, colours or gravity, is not asked there.
    """
    start = identity if given is None else given
    if start is None or task.everywhere or task.axis.any() or task.moving.colours is not None:
        return None
    if task.moving.dimension == 2 or not judge().sharp or judge().too_few:
        return None
    return fit_to_stay_at(judge(), searched.source, searched.target, start, end, vouched=given is not None)


def _moved_to(outcome: Outcome, pose: Array, limits: Criteria, observe: Callable[[Iteration], None] | None) -> Outcome:
    """The outcome with a last iteration that ends at a pose (4, 4), or its last one doing so where no more may be."""
    last = outcome.iterations[-1]._replace(pose=pose)
    if len(outcome.iterations) >= limits.max_iteration:
        return replace(outcome, pose=pose, iterations=(*outcome.iterations[:-1], last))
    if observe is not None:
        observe(last)
    return replace(outcome, pose=pose, iterations=(*outcome.iterations, last))


def _by_the_papers_weights(task: _Task) -> _Ended:
    """EM from one start, with the paper's weights and one of its rules for σ."""
    method, dimension = task.method, task.moving.dimension
    if task.everywhere:
        raise InputError(f"init: 'global' needs sigma_rule 'posterior', got {method.sigma_rule!r}")
    start = np.eye(4)
    if task.given is not None:
        start = task.given
    elif method.start == "init":
        start = task.normalisation.pose_in(np.eye(4))
    expectation = AdaptiveExpectation(
        make_pair_loop(task.moving, task.fixed, task.device), _sigma_rule(method, dimension), start
    )
    outcome = expectation_maximisation(
        expectation,
        start,
        replace(task.limits, relative_rmse=SLOW * task.limits.relative_rmse),
        dimension,
        relaxation=method.relaxation,
        axis=task.axis,
        observe=task.observe,
    )
    weigh: Callable[[], Verdict | None] = _none
    if outcome.stop_reason is not StopReason.NO_OVERLAP:
        judge = Deferred(partial(_judge_at_last, task.moving, task.fixed, task.seen_from))
        weigh = partial(_weigh, judge, outcome.pose, False, _gravity(task))
    return _Ended(start, outcome, weigh)


def _gravity(task: _Task) -> Array | None:
    return None if task.method.gravity is None else task.axis


def _assess_upright(assess: Callable[[], PoseUncertainty], axis: Array) -> PoseUncertainty:
    return held_by_gravity(assess(), axis)


def _inverse_outcome(outcome: Outcome) -> Outcome:
    """The same with source and target in each other's place."""
    poses = inverse_of(np.array([outcome.pose, *(iteration.pose for iteration in outcome.iterations)]))
    iterations = zip(outcome.iterations, poses[1:], strict=True)
    return replace(outcome, pose=poses[0], iterations=tuple(one._replace(pose=pose) for one, pose in iterations))


def _inverse(iteration: Iteration) -> Iteration:
    """The same with source and target in each other's place; the share of partners stays that of its own source."""
    return iteration._replace(pose=inverse_of(iteration.pose))


def _of_inverse(observe: Callable[[Iteration], None]) -> Callable[[Iteration], None]:
    """What observes the inverse of each iteration."""
    return lambda iteration: observe(_inverse(iteration))


def _judge_of(searched: Levels, viewpoints: tuple[Array | None, Array | None]) -> Judge:
    return Judge(searched.source, searched.target, searched.sampled(JUDGED), viewpoints)


def _judge_at_last(moving: Mixture, fixed: Mixture, viewpoints: tuple[Array | None, Array | None]) -> Judge:
    """The judge of a pose that was found without a search."""
    sides = Condensed(moving).searched, Condensed(fixed).searched
    return _judge_of(Levels(*sides, SCHEDULE, ANY_AXIS), viewpoints)


def _weigh(judge: Deferred[Judge], pose: Array, turned: bool, gravity: Array | None) -> Verdict:
    return verdict.weigh(judge(), pose, turned=turned, gravity=gravity)


def comes_second(source: Mixture, target: Mixture) -> bool:
    """Whether the search takes the target for its source, so that it finds the same whichever cloud is given first."""
    sizes = len(source), len(target)
    if sizes[0] != sizes[1] or source.on_device or target.on_device:
        return sizes[0] > sizes[1]
    first, second = (np.sort((mixture.points**2).sum(axis=1)).tolist() for mixture in (source, target))
    return bool(first > second)


def refines_inverse(normalisation: Normalisation, *, dense: bool, turned: bool) -> bool:
    """Whether the refinement takes the target for its source.

    The larger cloud is its target. Of dense ones, whose points stand for cells, it is its source: a dozen pairs of
    LiDAR scans are 6.4 mm off that way and 8.4 mm the other. Where neither is larger, it goes on as the search did,
    `turned` or not.
    """
    larger = normalisation.source_radius - normalisation.target_radius
    if abs(larger) < SAME_RADIUS:
        return turned
    return larger < 0.0 if dense else larger > 0.0


def _within(limits: Criteria, end: End) -> tuple[End, Criteria]:
    """An end with as much of the way there as is reported, and what `max_iteration` leaves for the last level."""
    count = sum(len(rows) for _, rows in end.trail)
    kept = min(count, limits.max_iteration // SEARCHING)
    limits = replace(limits, max_iteration=limits.max_iteration - kept)
    left_out = count - kept
    if left_out == 0:
        return end, limits
    trail = []
    start, rest = end.iterations[left_out - 1].pose, left_out
    for level, rows in end.trail:
        trail.append((level, rows[min(rest, len(rows)) :]))
        rest -= min(rest, len(rows))
    return end._replace(start=start, trail=tuple(trail)), limits


def _stay(
    moving: Mixture,
    fixed: Mixture,
    init: ArrayLike | str | None,
    given: Array | None,
    normalisation: Normalisation,
) -> PointRegistrationResult:
    """The start, to the last bit, as the result of no iteration."""
    if isinstance(init, str):
        raise InputError("criteria.max_iteration: expected at least 1 as init='global' names no pose, got 0")
    dimension = moving.dimension
    pose = normalisation.pose_in(np.eye(4)) if given is None else given
    result = conclude(
        pose,
        Outcome(pose, (), StopReason.MAX_ITERATION),
        normalisation,
        moving,
        fixed,
        Answers(partial(partners_at, moving, fixed, pose), _unknown, _none),
        ambiguous=False,
    )
    start = np.eye(dimension + 1) if init is None else np.array(init, np.float64)
    return replace(result, transformation=start, transformations=start[None].copy())


def _mutuality(method: TransformationEstimationForAdaptiveGMM, levels: Levels) -> float:
    if method.mutuality is not None:
        return method.mutuality
    return 0.0 if levels.small else 0.5


def _start_pose(init: ArrayLike, normalisation: Normalisation, dimension: int) -> Array:
    """(4, 4) `init` between the normalised clouds."""
    rotation, translation = split(init, name="init", tolerance=INIT_TOLERANCE)
    if len(translation) != dimension:
        raise InputError(f"init: expected shape ({dimension + 1}, {dimension + 1}), got {np.shape(init)}")
    pose = np.eye(4)
    pose[:dimension, :dimension] = project_to_rotation(rotation)
    pose[:dimension, 3] = translation
    return normalisation.pose_in(pose)


def _check_gravity(axis: Array, given: Array | None, dimension: int) -> Array | None:
    """The start made exactly upright, if one is given.

    Raises
    ------
    InputError : clouds in the plane, or a start that tilts gravity.
    """
    if dimension == 2:
        raise InputError("gravity: expected None for clouds in the plane, where all turns are about one axis")
    if given is None:
        return None
    tilt = math.degrees(math.acos(min(1.0, float(axis @ given[:3, :3] @ axis))))
    if tilt > MOST_TILT:
        raise InputError(
            f"init: expected a turn about gravity and a shift, as gravity is given, got one that tilts it {tilt:.2f}°; "
            "turn the clouds upright first, or leave gravity out"
        )
    return turned_about(axis, given)


def _sigma_rule(method: TransformationEstimationForAdaptiveGMM, dimension: int) -> SigmaRule:
    rules: dict[str, SigmaRule] = {
        "annealed": Annealed(dimension),
        "nearest": NearestDistance(dimension),
        "figure2": FigureTwo(),
    }
    return rules[method.sigma_rule]


def _observer(
    callback: Callback | None, normalisation: Normalisation, dimension: int
) -> Callable[[Iteration], None] | None:
    if callback is None:
        return None
    indices = Counter[int]()

    def observe(iteration: Iteration) -> None:
        callback(
            {
                "iteration_index": indices.total(),
                "scale_index": iteration.level,
                "scale_iteration_index": indices[iteration.level],
                "inlier_rmse": math.sqrt(iteration.energy * iteration.sigma) * normalisation.scale,
                "fitness": iteration.matched,
                "transformation": lower(normalisation.pose_out(iteration.pose), dimension),
                "sigma": normalisation.sigma_out(iteration.sigma),
                "energy": iteration.energy,
            }
        )
        indices[iteration.level] += 1

    return observe
