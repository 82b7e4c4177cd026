"""Registration of plain arrays in two or three dimensions; everything else is built on it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import starts
from .arguments import Array
from .cascade import SMALL, Cascade
from .em import Criteria, Outcome, expectation_maximisation
from .errors import DeviceError, InputError
from .expectation import CLOSE_VOLUME, OPEN_VOLUME, AdaptiveExpectation
from .kernels.pair_loop import PairLoop
from .lie import project_to_rotation, split
from .mixture import Mixture, Normalisation, make_mixture, normalise
from .options import DEFAULT_MAX_ITERATION, DEFAULT_RELATIVE_RMSE, TransformationEstimationForAdaptiveGMM
from .result import PointRegistrationResult, StopReason
from .sigma_rules import Annealed, FigureTwo, NearestDistance, SigmaRule
from .start_search import End
from .trace import Iteration

# A pose handed over by another program has float32 digits.
INIT_TOLERANCE = 1e-4
# A given start is believed when this share of the source has a partner where it leads.
PLAUSIBLE = 0.1

Observer = Callable[[dict[str, Any]], None]


def register_points(
    source: ArrayLike,
    target: ArrayLike,
    source_covariances: ArrayLike | None = None,
    target_covariances: ArrayLike | None = None,
    *,
    init: ArrayLike | None = None,
    estimation_method: TransformationEstimationForAdaptiveGMM | None = None,
    criteria: Any = None,
    device: str = "auto",
    callback_after_iteration: Observer | None = None,
) -> PointRegistrationResult:
    """Register the points `source` onto `target` as adaptive Gaussian mixtures, in 2D or 3D.

    Parameters
    ----------
    source, target : (M, D) and (N, D), D = 2 or 3, any real dtype, any unit; at least three points each.
    source_covariances, target_covariances : (M, D, D) and (N, D, D), symmetric positive definite; only their relative
        size matters, over both clouds. None stands for the identity at every point. A point whose covariance is not
        finite is ignored and counted; more than 1 % of them is an error.
    init : (D+1, D+1) rigid transformation source → target to start from; None leaves the start to the method.
    estimation_method : the options; None for the defaults.
    criteria : Open3D's ICPConvergenceCriteria; `relative_rmse` bounds the last step (see `em.Criteria`),
        `max_iteration` the EM iterations. None for 1e-3 and 200.
    device : "auto" or "cpu".
    callback_after_iteration : called after each EM iteration with a dictionary, see `registration_adaptive_gmm`.

    Returns
    -------
    PointRegistrationResult

    Raises
    ------
    InputTypeError, InputError, DegenerateError, DeviceError : one line naming the argument, what was wanted, what came.

    Source
    ------
    C. Pu, N. Li, R. B. Fisher: Robust Rigid Point Registration based on Convolution of Adaptive Gaussian Mixture
    Models; Figure 2, Eq. 5.
    """
    method = TransformationEstimationForAdaptiveGMM() if estimation_method is None else estimation_method
    _check_device(device)
    limits = _criteria(criteria)
    moving = make_mixture("source", source, source_covariances)
    fixed = make_mixture("target", target, target_covariances)
    if moving.dimension != fixed.dimension:
        raise InputError(
            f"target.points: expected shape (n, {moving.dimension}) as the source has, got (n, {fixed.dimension})"
        )
    dimension = moving.dimension
    moving, fixed, normalisation = normalise(moving, fixed)
    observe = _observer(callback_after_iteration, normalisation, dimension)
    given = None if init is None else _start_pose(init, normalisation, dimension)
    if method.sigma_rule == "posterior":
        cascade, best = _find(moving, fixed, method, given, normalisation)
        if observe is not None:
            for iteration in best.iterations:
                observe(iteration)
        start = best.start
        outcome = cascade.refine(
            best,
            limits,
            mutuality=_mutuality(method, moving, fixed),
            relaxation=method.relaxation,
            observe=observe,
        )
    else:
        start = np.eye(4) if given is None else given
        expectation = AdaptiveExpectation(PairLoop(moving, fixed), _sigma_rule(method, dimension), start)
        outcome = expectation_maximisation(
            expectation, start, limits, dimension, relaxation=method.relaxation, observe=observe
        )
    return _result(start, outcome, normalisation, moving, fixed)


def _find(
    source: Mixture,
    target: Mixture,
    method: TransformationEstimationForAdaptiveGMM,
    given: Array | None,
    normalisation: Normalisation,
) -> tuple[Cascade, End]:
    """The end to refine, on the deciding level, and the cascade that found it."""
    dimension = source.dimension
    centroids, identity = np.eye(4), normalisation.pose_in(np.eye(4))
    if given is not None and not np.allclose(given, identity):
        near = Cascade(source, target, CLOSE_VOLUME[dimension])
        best = max(near.run_deciding(starts.near(given)), key=lambda end: end.log_likelihood)
        if best.iterations[-1].matched >= PLAUSIBLE:
            return near, best
        bases = [given]
    else:
        bases = {"auto": [centroids, identity], "centroids": [centroids], "init": [identity]}[method.start]
    cascade = Cascade(source, target, OPEN_VOLUME[dimension])
    trusted = cascade.register_trusted([starts.wide(base) for base in bases])
    if not method.search or cascade.is_tight(trusted[1]):
        return cascade, trusted[1]
    others = [*starts.around(bases[0], dimension), *(starts.narrow(base) for base in bases[1:])]
    return cascade, cascade.search(others, trusted)[0]


def _mutuality(method: TransformationEstimationForAdaptiveGMM, source: Mixture, target: Mixture) -> float:
    if method.mutuality is not None:
        return method.mutuality
    return 0.5 if max(len(source), len(target)) > SMALL else 0.0


def _check_device(device: str) -> None:
    if device not in ("auto", "cpu"):
        raise DeviceError(f"device: expected 'auto' or 'cpu', got {device!r}")


def _criteria(criteria: Any) -> Criteria:
    if criteria is None:
        return Criteria(DEFAULT_RELATIVE_RMSE, DEFAULT_MAX_ITERATION)
    if criteria.max_iteration < 1:
        raise InputError(f"criteria.max_iteration: expected at least 1, got {criteria.max_iteration}")
    if not criteria.relative_rmse >= 0:
        raise InputError(f"criteria.relative_rmse: expected a number >= 0, got {criteria.relative_rmse}")
    return Criteria(float(criteria.relative_rmse), int(criteria.max_iteration))


def _start_pose(init: ArrayLike, normalisation: Normalisation, dimension: int) -> Array:
    """(4, 4) `init` between the normalised clouds."""
    rotation, translation = split(init, name="init", tolerance=INIT_TOLERANCE)
    if len(translation) != dimension:
        raise InputError(f"init: expected shape ({dimension + 1}, {dimension + 1}), got {np.shape(init)}")
    pose = np.eye(4)
    pose[:dimension, :dimension] = project_to_rotation(rotation)
    pose[:dimension, 3] = translation
    return normalisation.pose_in(pose)


def _sigma_rule(method: TransformationEstimationForAdaptiveGMM, dimension: int) -> SigmaRule:
    rules = {"annealed": Annealed(dimension), "nearest": NearestDistance(dimension), "figure2": FigureTwo()}
    return rules[method.sigma_rule]


def _observer(
    callback: Observer | None, normalisation: Normalisation, dimension: int
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
                "transformation": _lower(normalisation.pose_out(iteration.pose), dimension),
                "sigma": normalisation.sigma_out(iteration.sigma),
                "energy": iteration.energy,
            }
        )
        indices[iteration.level] += 1

    return observe


def _result(
    start: Array, outcome: Outcome, normalisation: Normalisation, moving: Mixture, fixed: Mixture
) -> PointRegistrationResult:
    dimension = moving.dimension
    poses = np.array([start, *(i.pose for i in outcome.iterations)])
    poses = _lower(normalisation.pose_out(poses), dimension)
    warnings = [] if outcome.stop_reason is StopReason.CONVERGED else [str(outcome.stop_reason)]
    return PointRegistrationResult(
        transformation=poses[-1],
        stop_reason=outcome.stop_reason,
        iterations=len(outcome.iterations),
        sigmas=np.array([normalisation.sigma_out(i.sigma) for i in outcome.iterations]),
        energies=np.array([i.energy for i in outcome.iterations]),
        transformations=poses,
        overlap=outcome.iterations[-1].matched if outcome.iterations else 0.0,
        row_weights=np.zeros(len(moving)) if outcome.sums is None else outcome.sums.row_weights,
        dropped_source=moving.dropped,
        dropped_target=fixed.dropped,
        pose_covariance=None,
        unobservable=(),
        ambiguous=False,
        warnings=tuple(warnings),
    )


def _lower(poses: Array, dimension: int) -> Array:
    """(…, 4, 4) poses → (…, D+1, D+1)."""
    if dimension == 3:
        return poses
    keep = np.array([0, 1, 3])
    return np.ascontiguousarray(poses[..., keep[:, None], keep])
