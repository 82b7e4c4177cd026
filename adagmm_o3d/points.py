"""Registration of plain arrays in two or three dimensions; everything else is built on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .arguments import Array
from .em import Criteria, Trace, expectation_maximisation
from .errors import DeviceError, InputError
from .expectation import AdaptiveExpectation, Expectation, PosteriorExpectation
from .kernels.pair_loop import PairLoop
from .lie import project_to_rotation, split
from .mixture import Mixture, Normalisation, make_mixture, normalise
from .options import DEFAULT_MAX_ITERATION, DEFAULT_RELATIVE_RMSE, TransformationEstimationForAdaptiveGMM
from .result import PointRegistrationResult, StopReason
from .sigma_rules import Annealed, FigureTwo, NearestDistance

# A pose handed over by another program has float32 digits.
INIT_TOLERANCE = 1e-4
# The posterior's first σ: a third of the radius is one standard deviation and a half.
FIRST_SIGMA = 0.3

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
        `max_iteration` the EM iterations. None for 1e-4 and 200.
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
    start = _start(init, normalisation, dimension)
    pairs = PairLoop(moving, fixed)
    observe = _observer(callback_after_iteration, normalisation, dimension)
    expectation = _expectation(method, pairs, dimension, start)
    trace = expectation_maximisation(expectation, start, limits, dimension, method.relaxation, observe)
    return _result(trace, normalisation, moving, fixed)


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


def _start(init: ArrayLike | None, normalisation: Normalisation, dimension: int) -> Array:
    if init is None:
        return np.eye(4)
    rotation, translation = split(init, name="init", tolerance=INIT_TOLERANCE)
    if len(translation) != dimension:
        raise InputError(f"init: expected shape ({dimension + 1}, {dimension + 1}), got {np.shape(init)}")
    pose = np.eye(4)
    pose[:dimension, :dimension] = project_to_rotation(rotation)
    pose[:dimension, 3] = translation
    if np.array_equal(pose, np.eye(4)):
        return pose
    return normalisation.pose_in(pose)


def _expectation(
    method: TransformationEstimationForAdaptiveGMM, pairs: PairLoop, dimension: int, start: Array
) -> Expectation:
    if method.sigma_rule == "posterior":
        return PosteriorExpectation(pairs, dimension, FIRST_SIGMA)
    rules = {"annealed": Annealed(dimension), "nearest": NearestDistance(dimension), "figure2": FigureTwo()}
    return AdaptiveExpectation(pairs, rules[method.sigma_rule], start)


def _observer(
    callback: Observer | None, normalisation: Normalisation, dimension: int
) -> Callable[[Trace], None] | None:
    if callback is None:
        return None

    def observe(trace: Trace) -> None:
        index = len(trace.energies) - 1
        sums = trace.sums
        callback(
            {
                "iteration_index": index,
                "scale_index": 0,
                "scale_iteration_index": index,
                "inlier_rmse": float(np.sqrt(trace.energies[-1] * trace.scales[-1].target)) * normalisation.scale,
                "fitness": float(getattr(sums, "overlap", 1.0)),
                "transformation": _lower(normalisation.pose_out(trace.poses[-1]), dimension),
                "sigma": normalisation.sigma_out(trace.scales[-1].target),
                "energy": trace.energies[-1],
            }
        )

    return observe


def _result(trace: Trace, normalisation: Normalisation, moving: Mixture, fixed: Mixture) -> PointRegistrationResult:
    dimension = moving.dimension
    poses = _lower(normalisation.pose_out(np.array(trace.poses)), dimension)
    warnings = [] if trace.stop_reason is StopReason.CONVERGED else [str(trace.stop_reason)]
    return PointRegistrationResult(
        transformation=poses[-1],
        stop_reason=trace.stop_reason,
        iterations=len(trace.energies),
        sigmas=np.array([normalisation.sigma_out(s.target) for s in trace.scales]),
        energies=np.array(trace.energies),
        transformations=poses,
        overlap=float(getattr(trace.sums, "overlap", np.nan)),
        row_weights=trace.sums.row_weights,
        dropped_source=moving.dropped,
        dropped_target=fixed.dropped,
        pose_covariance=None,
        unobservable=trace.unobservable,
        ambiguous=False,
        warnings=tuple(warnings),
    )


def _lower(poses: Array, dimension: int) -> Array:
    """(…, 4, 4) poses → (…, D+1, D+1)."""
    if dimension == 3:
        return poses
    keep = np.array([0, 1, 3])
    return np.ascontiguousarray(poses[..., keep[:, None], keep])
