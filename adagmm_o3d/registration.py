"""Open3D in, Open3D out: `registration_adaptive_gmm` for legacy and tensor point clouds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, real_number
from adagmm_o3d.array_registration import register_points
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.lazy_open3d import o3d
from adagmm_o3d.options import (
    Callback,
    CriteriaArgument,
    DeviceName,
    EstimationMethod,
    check_callback,
    check_criteria,
    check_estimation_method,
)
from adagmm_o3d.uncertainty import estimate_surface_covariances

if TYPE_CHECKING:
    from adagmm_o3d.open3d_results import RegistrationResult, TensorRegistrationResult


@overload
def registration_adaptive_gmm(
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    max_correspondence_distance: float,
    init: ArrayLike | o3d.core.Tensor | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    voxel_size: float = -1.0,
    callback_after_iteration: Callback | None = None,
    *,
    init_source_to_target: ArrayLike | o3d.core.Tensor | str | None = None,
    device: DeviceName = "auto",
) -> RegistrationResult: ...


@overload
def registration_adaptive_gmm(  # type: ignore[overload-cannot-match]  # Open3D's types are skipped here, not by users
    source: o3d.t.geometry.PointCloud,
    target: o3d.t.geometry.PointCloud,
    max_correspondence_distance: float,
    init: ArrayLike | o3d.core.Tensor | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    voxel_size: float = -1.0,
    callback_after_iteration: Callback | None = None,
    *,
    init_source_to_target: ArrayLike | o3d.core.Tensor | str | None = None,
    device: DeviceName = "auto",
) -> TensorRegistrationResult: ...


def registration_adaptive_gmm(
    source: o3d.geometry.PointCloud | o3d.t.geometry.PointCloud,
    target: o3d.geometry.PointCloud | o3d.t.geometry.PointCloud,
    max_correspondence_distance: float,
    init: ArrayLike | o3d.core.Tensor | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    voxel_size: float = -1.0,
    callback_after_iteration: Callback | None = None,
    *,
    init_source_to_target: ArrayLike | o3d.core.Tensor | str | None = None,
    device: DeviceName = "auto",
) -> RegistrationResult | TensorRegistrationResult:
    """Register `source` onto `target` as adaptive Gaussian mixtures; a drop-in for Open3D's ICP and GICP.

    Two legacy clouds behave as `o3d.pipelines.registration.registration_generalized_icp`, two tensor clouds as
    `o3d.t.pipelines.registration.icp`, whose keyword `init_source_to_target` is taken as well.

    Parameters
    ----------
    source, target : (M,) and (N,) point clouds of one kind, float32 or float64, at least three points each. Covariances
        come from `PointCloud.covariances` or `point.covariances`; only their relative size matters. A cloud without any
        gets those of its surface, estimated from each point's nearest neighbours (`estimate_surface_covariances`).
    max_correspondence_distance : [input units] > 0. The method chooses no correspondences; this is the distance within
        which `fitness`, `inlier_rmse` and `correspondence_set` count them, as Open3D's `evaluate_registration` does.
    init : (4, 4) rigid transformation source → target to start from; the identity (also when left out) lets the
        method choose between it and common centroids; "global" searches all rotations.
    estimation_method : TransformationEstimationForAdaptiveGMM. Open3D's own methods are accepted, so that a script
        needs no change, and stand for the default options; one that estimates a scale is refused.
    criteria : Open3D's ICPConvergenceCriteria, legacy or tensor. `relative_rmse` and `relative_fitness` bound the
        change of the weighted residual and of the pair weights in an iteration, `max_iteration` the EM iterations.
    voxel_size : [input units] > 0 downsamples both clouds first, as `o3d.t.pipelines.registration.icp` does.
    device : "cpu", "cuda", or "auto": a GPU where there is one and enough to do. Tensor clouds on a CUDA device are
        registered there, whatever their size, unless "cpu" is asked for or `adagmm-o3d[cuda]` is not installed.
    callback_after_iteration : called after each EM iteration with `iteration_index`, `scale_index`,
        `scale_iteration_index`, `fitness`, `inlier_rmse`, `transformation`, `sigma` and `energy`; tensors for tensor
        clouds, Python numbers and an array for legacy ones. There `fitness` is the estimated overlap and `inlier_rmse`
        the weighted residual [input units].

    Returns
    -------
    Open3D's RegistrationResult of the same kind as the clouds, with the EM's record in its attribute `details`.

    Raises
    ------
    InputTypeError, InputError, DegenerateError, DeviceError : one line naming the argument, what was wanted, what came.

    Source
    ------
    C. Pu, N. Li, R. B. Fisher: Robust Rigid Point Registration based on Convolution of Adaptive Gaussian Mixture
    Models.
    """
    if init is not None and init_source_to_target is not None:
        raise InputError("init: given twice, as init and as init_source_to_target; give one")
    start = init if init is not None else init_source_to_target
    if isinstance(start, o3d.core.Tensor):
        start = start.cpu().numpy()
    method = check_estimation_method(estimation_method)
    check_criteria(criteria)
    check_callback(callback_after_iteration)
    distance = real_number("max_correspondence_distance", max_correspondence_distance, above=0.0)
    voxel_size = real_number("voxel_size", voxel_size)
    if isinstance(source, o3d.t.geometry.PointCloud) and isinstance(target, o3d.t.geometry.PointCloud):
        from adagmm_o3d.tensor_registration import register_tensor_clouds

        return register_tensor_clouds(
            source, target, distance, start, method, criteria, voxel_size, device, callback_after_iteration
        )
    _check_legacy(source, target)
    if voxel_size > 0:
        source, target = (_thinned(name, cloud, voxel_size) for name, cloud in (("source", source), ("target", target)))
    details = register_points(
        np.asarray(source.points),
        np.asarray(target.points),
        legacy_covariances("source", source),
        legacy_covariances("target", target),
        init=start,
        estimation_method=method,
        criteria=criteria,
        device=device,
        callback_after_iteration=callback_after_iteration,
    )
    evaluated = o3d.pipelines.registration.evaluate_registration(source, target, distance, details.transformation)
    from adagmm_o3d.open3d_results import RegistrationResult

    result = RegistrationResult()
    result.transformation = details.transformation
    result.fitness = evaluated.fitness
    result.inlier_rmse = evaluated.inlier_rmse
    result.correspondence_set = evaluated.correspondence_set
    result.details = details
    return result


def _check_legacy(source: Any, target: Any) -> None:
    """Raise unless both are legacy clouds; that both are tensor clouds has been ruled out."""
    legacy, tensor = o3d.geometry.PointCloud, o3d.t.geometry.PointCloud
    for name, cloud in (("source", source), ("target", target)):
        if not isinstance(cloud, (legacy, tensor)):
            raise InputTypeError(
                f"{name}: expected an open3d.geometry.PointCloud or open3d.t.geometry.PointCloud, "
                f"got {type(cloud).__name__}; for arrays see register_points()"
            )
    if isinstance(source, tensor) or isinstance(target, tensor):
        is_tensor = isinstance(source, tensor)
        wanted, got = ("open3d.t", "open3d") if is_tensor else ("open3d", "open3d.t")
        convert = "open3d.t.geometry.PointCloud.from_legacy()" if is_tensor else ".to_legacy()"
        raise InputTypeError(
            f"target: expected a {wanted}.geometry.PointCloud as the source is, "
            f"got a {got}.geometry.PointCloud; convert it with {convert}"
        )


def _thinned(name: str, cloud: o3d.geometry.PointCloud, voxel_size: float) -> o3d.geometry.PointCloud:
    from adagmm_o3d.tensor_registration import check_voxel_size

    if len(cloud.points):
        check_voxel_size(name, cloud.get_min_bound(), cloud.get_max_bound(), voxel_size)
    return cloud.voxel_down_sample(voxel_size)


def legacy_covariances(name: str, cloud: o3d.geometry.PointCloud) -> Array | None:
    """(n, 3, 3) covariances of a legacy cloud, estimated from the surface where it has none."""
    if len(cloud.covariances) == 0:
        points = np.asarray(cloud.points)
        return estimate_surface_covariances(points) if len(points) >= 3 and np.isfinite(points).all() else None
    covariances = np.asarray(cloud.covariances)
    if len(covariances) != len(cloud.points):
        raise InputError(
            f"{name}.covariances: expected one for each of the {len(cloud.points)} points, got {len(covariances)}"
        )
    return covariances
