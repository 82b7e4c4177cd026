"""Registration of plain arrays in two or three dimensions; everything else is built on it."""

from __future__ import annotations

from numpy.typing import ArrayLike

from adagmm_o3d.errors import InputError
from adagmm_o3d.options import (
    Callback,
    CriteriaArgument,
    DeviceName,
    EstimationMethod,
    check_callback,
    check_criteria,
    check_estimation_method,
)
from adagmm_o3d.pairs.device import check_device, mixture_maker
from adagmm_o3d.result import PointRegistrationResult


def register_points(
    source: ArrayLike,
    target: ArrayLike,
    source_covariances: ArrayLike | None = None,
    target_covariances: ArrayLike | None = None,
    *,
    init: ArrayLike | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    device: DeviceName = "auto",
    callback_after_iteration: Callback | None = None,
) -> PointRegistrationResult:
    """Register the points `source` onto `target` as adaptive Gaussian mixtures, in 2D or 3D.

    Parameters
    ----------
    source, target : (M, D) and (N, D), D = 2 or 3, any real dtype, any unit; at least three points each.
    source_covariances, target_covariances : (M, D, D) and (N, D, D), symmetric positive definite; only their relative
        size matters, over both clouds. None stands for the identity at every point. A point whose covariance is not
        finite is ignored and counted; more than 1 % of them is an error.
    init : (D+1, D+1) rigid transformation source → target. Other than the identity it is believed as long as it leads
        to a plausible overlap: the search stays near it. The identity, or None, leaves the choice between the identity
        and common centroids, with starts around, to the likelihood. "global" searches all rotations.
    estimation_method : the options; None, or one of Open3D's own, for the defaults.
    criteria : `Criteria`, or Open3D's ICPConvergenceCriteria; `relative_rmse` bounds the last step, `max_iteration` the
        EM iterations on all points (the levels before have a few dozen). None for 1e-3 and 200.
    device : "cpu", "cuda", or "auto": a GPU where there is one and enough to do. The coarse levels stay on the CPU.
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
    method, limits = check_estimation_method(estimation_method), check_criteria(criteria)
    callback = check_callback(callback_after_iteration)
    check_device(device)
    make_mixture = mixture_maker(device, source, target)
    moving = make_mixture("source", source, source_covariances)
    fixed = make_mixture("target", target, target_covariances)
    if moving.dimension != fixed.dimension:
        raise InputError(
            f"target.points: expected shape (n, {moving.dimension}) as the source has, got (n, {fixed.dimension})"
        )
    # Compiled kernels come with Numba, whose import takes as long as a registration: only with the first.
    from adagmm_o3d.search.register import register_mixtures

    return register_mixtures(moving, fixed, init, method, limits, device, callback)
