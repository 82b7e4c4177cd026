"""Registration of plain arrays in two or three dimensions; everything else is built on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, float_array
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.mixtures.colours import checked_colors
from adagmm_o3d.mixtures.mixture import Mixture
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
from adagmm_o3d.prepared import PreparedCloud
from adagmm_o3d.result import PointRegistrationResult
from adagmm_o3d.uncertainty.surface import scan_covariances


def register_points(
    source: ArrayLike | PreparedCloud[Any],
    target: ArrayLike | PreparedCloud[Any],
    source_covariances: ArrayLike | None = None,
    target_covariances: ArrayLike | None = None,
    *,
    init: ArrayLike | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    device: DeviceName = "auto",
    source_viewpoint: ArrayLike | None = None,
    target_viewpoint: ArrayLike | None = None,
    source_colors: ArrayLike | None = None,
    target_colors: ArrayLike | None = None,
    callback_after_iteration: Callback | None = None,
) -> PointRegistrationResult:
    """Register the points `source` onto `target` as adaptive Gaussian mixtures, in 2D or 3D.

    Parameters
    ----------
    source, target : (M, D) and (N, D), D = 2 or 3, any real dtype, any unit; at least three points each. Those that
        are not finite, as organised clouds have them where nothing was measured, are ignored and counted. Or what
        `prepare` made of one, with its covariances, to register it with many others.
    source_covariances, target_covariances : (M, D, D) and (N, D, D), symmetric positive semidefinite; only their
        relative size matters, over both clouds. None stands for the identity at every point; in space, of a dense cloud
        and of one of scan lines, for `estimate_surface_covariances`, or the rings of a LiDAR would be laid on each
        other. A cloud in place of an array gets these too, as large as the other's where that has its own. Singular
        ones, like those that Open3D estimates on flat faces, are given the thickness of a surface and counted, see
        `make_mixture`. A point whose covariance is not finite is ignored and counted; more than 1 % is an error.
    init : (D+1, D+1) rigid transformation source → target; a rotation written with few digits is made exact. It is
        refined nearby, and competes with what common centroids, starts around them and, in space, local features
        propose: it wins where what is near it holds no less than what explains most, or explains the clouds as well as
        the halves of one cloud explain each other, or where none of the others does clearly better. None stands for
        the identity. "global": nothing is known of the pose, and where features find none all rotations are tried.
    estimation_method : the options; None, or one of Open3D's own, for the defaults.
    criteria : `Criteria`, or Open3D's ICPConvergenceCriteria; `relative_rmse` bounds the last step, `max_iteration`
        the iterations reported; with 0 of them `init`, or the identity, is the result. None, or
        Open3D's own defaults, for 1e-3 and 200.
    device : "cpu", "cuda", or "auto": a GPU where there is one and enough to do. The coarse levels stay on the CPU.
    source_viewpoint, target_viewpoint : (D,) from where each cloud was seen, in its own frame and unit, e.g. zeros for
        a cloud in its camera's frame; None where that is not known. What a sensor has seen through cannot be where the
        other cloud's points come to lie, which decides where shape alone does not. In 2D they are checked and not used.
    source_colors, target_colors : (M, 3) and (N, 3) sRGB, 0 to 1 (what is beyond by up to 0.05 is cut off) or as uint8
        0 to 255; or (M,) and (N,), or with one column, intensities of any unit. Both or neither; where they are given
        they are looked at: points whose colours are alike are likelier to be the same place. How far two looks at a
        place differ, the share of colours that lie and what one sensor makes of the other's colours are estimated, see
        `PointRegistrationResult.color`.
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
    make_mixture = mixture_maker(device, *(c.points if isinstance(c, PreparedCloud) else c for c in (source, target)))
    moving = _mixture("source", source, source_covariances, make_mixture)
    fixed = _mixture("target", target, target_covariances, make_mixture)
    moving, fixed = _on_one_scale(source, target, moving, fixed, make_mixture)
    if moving.dimension != fixed.dimension:
        raise InputError(
            f"target.points: expected shape (n, {moving.dimension}) as the source has, got (n, {fixed.dimension})"
        )
    kept = moving.kept, fixed.kept
    if (colors := checked_colors(source_colors, target_colors, kept, needed=method.color)) is not None:
        moving, fixed = moving.coloured(colors[0]), fixed.coloured(colors[1])
    viewpoints = checked_viewpoints(source_viewpoint, target_viewpoint, dimension=moving.dimension)
    # Compiled kernels come with Numba, whose import takes as long as a registration: only with the first.
    from adagmm_o3d.search.register import register_mixtures

    return register_mixtures(moving, fixed, init, method, limits, device, callback, viewpoints)


def _mixture(
    name: str, cloud: ArrayLike | PreparedCloud[Any], covariances: ArrayLike | None, make: Callable[..., Mixture]
) -> Mixture:
    if not isinstance(cloud, PreparedCloud):
        if type(cloud).__name__ == "PointCloud":
            raise InputTypeError(f"{name}: expected an array, got a PointCloud; see registration_adaptive_gmm()")
        return make(name, *with_covariances(name, cloud, covariances))
    if covariances is not None:
        raise InputError(f"{name}_covariances: {name} was prepared with its covariances; give them to prepare()")
    return cloud.mixture(name, make)


def with_covariances(name: str, points: ArrayLike, covariances: ArrayLike | None) -> tuple[ArrayLike, ArrayLike | None]:
    """Points (n, D) and their covariances, or those that stand for them in scans; `name` begins an error."""
    if covariances is not None:
        return points, covariances
    p = float_array(f"{name}.points", points, ("n", (2, 3)), finite=False)
    return p, scan_covariances(p)


def _on_one_scale(
    source: ArrayLike | PreparedCloud[Any],
    target: ArrayLike | PreparedCloud[Any],
    moving: Mixture,
    fixed: Mixture,
    make: Callable[..., Mixture],
) -> tuple[Mixture, Mixture]:
    """Both mixtures; those of a cloud's surface have no unit, and become as large as what came with the other cloud."""
    if not (isinstance(source, PreparedCloud) and isinstance(target, PreparedCloud)) or source.given == target.given:
        return moving, fixed
    if "array" in (source.kind, target.kind):
        return moving, fixed
    if source.given:
        return moving, target.mixture_as_vague_as("target", make, moving)
    return source.mixture_as_vague_as("source", make, fixed), fixed


def checked_viewpoints(
    source: ArrayLike | None, target: ArrayLike | None, *, dimension: int
) -> tuple[Array | None, Array | None]:
    """(3,) each, from where the clouds were seen; in the plane z = 0 for 2D.

    Raises
    ------
    InputTypeError, InputError : not `dimension` finite numbers.
    """

    def checked(name: str, value: ArrayLike | None) -> Array | None:
        if value is None:
            return None
        viewpoint = np.zeros(3)
        viewpoint[:dimension] = float_array(name, value, (dimension,))
        return viewpoint

    return checked("source_viewpoint", source), checked("target_viewpoint", target)
