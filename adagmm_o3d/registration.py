"""Open3D in, Open3D out: `registration_adaptive_gmm` for legacy and tensor point clouds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, distance_limit, real_number
from adagmm_o3d.array_registration import register_points
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.evaluation import evaluate_registration
from adagmm_o3d.kernels.limits import EPSILON
from adagmm_o3d.lazy_open3d import o3d
from adagmm_o3d.options import (
    Callback,
    CriteriaArgument,
    DeviceName,
    EstimationMethod,
    check_callback,
    check_criteria,
    check_estimation_method,
    surface_thickness,
)
from adagmm_o3d.prepared import PreparedCloud
from adagmm_o3d.result import Deferred
from adagmm_o3d.uncertainty.surface import stand_in_covariances

if TYPE_CHECKING:
    from adagmm_o3d.open3d_results import RegistrationResult, TensorRegistrationResult


@overload
def registration_adaptive_gmm(
    source: o3d.geometry.PointCloud | PreparedCloud[o3d.geometry.PointCloud],
    target: o3d.geometry.PointCloud | PreparedCloud[o3d.geometry.PointCloud],
    max_correspondence_distance: float,
    init: ArrayLike | o3d.core.Tensor | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    voxel_size: float = -1.0,
    callback_after_iteration: Callback | None = None,
    *,
    init_source_to_target: ArrayLike | o3d.core.Tensor | str | None = None,
    device: DeviceName = "auto",
    source_viewpoint: ArrayLike | None = None,
    target_viewpoint: ArrayLike | None = None,
) -> RegistrationResult: ...


@overload
def registration_adaptive_gmm(  # type: ignore[overload-cannot-match]  # Open3D's types are skipped here, not by users
    source: o3d.t.geometry.PointCloud | PreparedCloud[o3d.t.geometry.PointCloud],
    target: o3d.t.geometry.PointCloud | PreparedCloud[o3d.t.geometry.PointCloud],
    max_correspondence_distance: float,
    init: ArrayLike | o3d.core.Tensor | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    voxel_size: float = -1.0,
    callback_after_iteration: Callback | None = None,
    *,
    init_source_to_target: ArrayLike | o3d.core.Tensor | str | None = None,
    device: DeviceName = "auto",
    source_viewpoint: ArrayLike | None = None,
    target_viewpoint: ArrayLike | None = None,
) -> TensorRegistrationResult: ...


def registration_adaptive_gmm(
    source: o3d.geometry.PointCloud | o3d.t.geometry.PointCloud | PreparedCloud[Any],
    target: o3d.geometry.PointCloud | o3d.t.geometry.PointCloud | PreparedCloud[Any],
    max_correspondence_distance: float,
    init: ArrayLike | o3d.core.Tensor | str | None = None,
    estimation_method: EstimationMethod = None,
    criteria: CriteriaArgument = None,
    voxel_size: float = -1.0,
    callback_after_iteration: Callback | None = None,
    *,
    init_source_to_target: ArrayLike | o3d.core.Tensor | str | None = None,
    device: DeviceName = "auto",
    source_viewpoint: ArrayLike | None = None,
    target_viewpoint: ArrayLike | None = None,
) -> RegistrationResult | TensorRegistrationResult:
    """Register `source` onto `target` as adaptive Gaussian mixtures; a drop-in for Open3D's ICP and GICP.

    Two legacy clouds behave as `o3d.pipelines.registration.registration_generalized_icp`, two tensor clouds as
    `o3d.t.pipelines.registration.icp`, whose keyword `init_source_to_target` is taken as well.

    Parameters
    ----------
    source, target : (M,) and (N,) point clouds of one kind, float32 or float64, at least three points each. Those that
        are not finite, as organised clouds have them where nothing was measured, are ignored and counted. Covariances
        come from `PointCloud.covariances` or `point.covariances`; only their relative size matters. A cloud without any
        gets those of its surface (`estimate_surface_covariances`), as large as the other's own: along its normals where
        it has any, as in Open3D's GICP, or else from each point's nearest neighbours, for which it takes four points.
        Or what `prepare` made of one, to register it with many others.
    max_correspondence_distance : [input units] > 0, infinity for no limit. The method chooses no correspondences;
        within this distance `fitness`, `inlier_rmse` and `correspondence_set` count them, as Open3D's
        `evaluate_registration` does.
    init : (4, 4) rigid transformation source → target. It is refined nearby, the identity (also when left out) too, and
        competes with what common centroids and local features propose; "global" says that nothing is known of the pose.
        See `register_points`.
    estimation_method : TransformationEstimationForAdaptiveGMM. Open3D's own methods and robust kernels are accepted, so
        that a script needs no change, and stand for the default options, which the log says once; that for coloured ICP
        for `color`, with the colours of `PointCloud.colors`, `point.colors` or else `point.intensity`; one that
        estimates a scale is refused. The `epsilon` of that for GICP is the thickness of surfaces where legacy clouds
        have no covariances; 0 stands for its default, more than 1 for 1.
    criteria : Open3D's ICPConvergenceCriteria, legacy or tensor. `relative_rmse` bounds the change of the weighted
        residual in the last iteration, `max_iteration` the iterations reported; with 0 of them `init` is evaluated, and
        is the result. `relative_fitness` is not read. Left out, or Open3D's own defaults: 1e-3 and 200.
    voxel_size : [input units] > 0 downsamples both clouds first, as `o3d.t.pipelines.registration.icp` does.
    device : "cpu", "cuda", or "auto": a GPU where there is one and enough to do. Tensor clouds on a CUDA device are
        registered there, whatever their size, unless "cpu" is asked for or `adagmm-o3d[cuda]` is not installed.
    source_viewpoint, target_viewpoint : (3,) from where each cloud was seen, in its own frame and unit, e.g. zeros for
        a cloud in its camera's frame; None where that is not known. What a sensor has seen through cannot be where the
        other cloud's points come to lie, which decides where shape alone does not.
    callback_after_iteration : called after each EM iteration with `iteration_index`, `scale_index`,
        `scale_iteration_index`, `fitness`, `inlier_rmse`, `transformation`, `sigma` and `energy`; tensors for tensor
        clouds, Python numbers and an array for legacy ones. There `fitness` is the estimated overlap and `inlier_rmse`
        the weighted residual [input units]. Iterations of the last level, on all points, are told as they happen; those
        of the levels before, of which there is a record of the winning start alone, at once when the search has ended.

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
    thickness = surface_thickness(estimation_method)
    if isinstance(max_correspondence_distance, (list, tuple, o3d.utility.DoubleVector)):
        raise InputTypeError(
            f"max_correspondence_distance: expected a real number, got {type(max_correspondence_distance).__name__}; "
            "for several sizes see multi_scale_registration_adaptive_gmm()"
        )
    distance = distance_limit("max_correspondence_distance", max_correspondence_distance)
    voxel_size = real_number("voxel_size", voxel_size)
    if kind_of(source) == "tensor" and kind_of(target) == "tensor":
        from adagmm_o3d.tensor_registration import register_tensor_clouds

        return register_tensor_clouds(
            source,
            target,
            distance,
            start,
            method,
            criteria,
            voxel_size,
            device,
            callback_after_iteration,
            (source_viewpoint, target_viewpoint),
        )
    _check_legacy(source, target)
    moving, fixed = (
        _made_ready(name, cloud, voxel_size, thickness) for name, cloud in (("source", source), ("target", target))
    )
    details = register_points(
        moving,
        fixed,
        init=start,
        estimation_method=method,
        criteria=criteria,
        device=device,
        source_viewpoint=source_viewpoint,
        target_viewpoint=target_viewpoint,
        source_colors=_colors("source", moving.cloud) if method.color else None,
        target_colors=_colors("target", fixed.cloud) if method.color else None,
        callback_after_iteration=callback_after_iteration,
    )
    # Open3D's own adds up, and lists the pairs, in whatever order its threads end.
    points = np.asarray(moving.cloud.points), np.asarray(fixed.cloud.points)
    evaluated = evaluate_registration(*points, distance, details.transformation)
    from adagmm_o3d.open3d_results import RegistrationResult

    result = RegistrationResult()
    result.transformation = details.transformation
    result.fitness = evaluated.fitness
    result.inlier_rmse = evaluated.inlier_rmse
    result.correspondence_set = o3d.utility.Vector2iVector(evaluated.correspondence_set)
    result.details = details
    return result


def _check_legacy(source: Any, target: Any) -> None:
    """Raise unless both are legacy clouds; that both are tensor clouds has been ruled out."""
    for name, cloud in (("source", source), ("target", target)):
        if kind_of(cloud) not in ("legacy", "tensor"):
            got = "an array that was prepared" if isinstance(cloud, PreparedCloud) else type(cloud).__name__
            raise InputTypeError(
                f"{name}: expected an open3d.geometry.PointCloud or open3d.t.geometry.PointCloud, "
                f"got {got}; for arrays see register_points()"
            )
    if kind_of(source) == "tensor" or kind_of(target) == "tensor":
        is_tensor = kind_of(source) == "tensor"
        wanted, got = ("open3d.t", "open3d") if is_tensor else ("open3d", "open3d.t")
        convert = "open3d.t.geometry.PointCloud.from_legacy()" if is_tensor else ".to_legacy()"
        prepared, when = ("a prepared", ", then prepare it") if isinstance(target, PreparedCloud) else ("an", "")
        raise InputTypeError(
            f"target: expected an {wanted}.geometry.PointCloud as the source is, "
            f"got {prepared} {got}.geometry.PointCloud; convert it with {convert}{when}"
        )


def _colors(name: str, cloud: o3d.geometry.PointCloud) -> Array | None:
    """(n, 3) colours of a legacy cloud, None where it has none."""
    colors = np.asarray(cloud.colors)
    if len(colors) not in (0, len(cloud.points)):
        raise InputError(f"{name}.colors: expected one for each of the {len(cloud.points)} points, got {len(colors)}")
    return colors if len(colors) else None


def kind_of(cloud: Any) -> str | None:
    """The door for a cloud, prepared or not; None for what is neither of Open3D's clouds nor prepared."""
    if isinstance(cloud, PreparedCloud):
        return cloud.kind
    if isinstance(cloud, o3d.t.geometry.PointCloud):
        return "tensor"
    return "legacy" if isinstance(cloud, o3d.geometry.PointCloud) else None


def _made_ready(
    name: str,
    cloud: o3d.geometry.PointCloud | PreparedCloud[o3d.geometry.PointCloud],
    voxel_size: float,
    thickness: float | None,
) -> PreparedCloud[o3d.geometry.PointCloud]:
    if isinstance(cloud, PreparedCloud):
        cloud.check_made_with(name, voxel_size, thickness)
        return cloud
    return ready_legacy(name, cloud, voxel_size, EPSILON if thickness is None else thickness)


def ready_legacy(
    name: str, cloud: o3d.geometry.PointCloud, voxel_size: float, epsilon: float
) -> PreparedCloud[o3d.geometry.PointCloud]:
    """A legacy cloud ready to be registered, thinned where `voxel_size` is above zero; without a copy where not."""
    given = cloud.has_covariances()
    if voxel_size > 0.0:
        cloud = _thinned(name, cloud, voxel_size, epsilon)
    arrays = np.asarray(cloud.points), legacy_covariances(name, cloud, epsilon)
    return PreparedCloud("legacy", cloud, Deferred(lambda: arrays), voxel_size, epsilon, given=given)


def _thinned(name: str, cloud: o3d.geometry.PointCloud, voxel_size: float, thickness: float) -> o3d.geometry.PointCloud:
    """Voxel averages. Normals become covariances first: the mean of two that point to opposite sides means nothing."""
    from adagmm_o3d.tensor_registration import check_voxel_size

    if not np.isfinite(cloud.points).all():
        cloud = o3d.geometry.PointCloud(cloud).remove_non_finite_points()
    if len(cloud.points):
        check_voxel_size(name, cloud.get_min_bound(), cloud.get_max_bound(), voxel_size)
    if cloud.has_normals() and not cloud.has_covariances():
        covariances = legacy_covariances(name, cloud, thickness)
        cloud = o3d.geometry.PointCloud(cloud)
        if covariances is not None:
            cloud.covariances = o3d.utility.Matrix3dVector(covariances)
    return cloud.voxel_down_sample(voxel_size)


def legacy_covariances(name: str, cloud: o3d.geometry.PointCloud, thickness: float) -> Array | None:
    """(n, 3, 3) covariances of a legacy cloud; those of its surface, with that variance across it, where it has none.

    None for what is no cloud.
    """
    for what, values in (("covariances", cloud.covariances), ("normals", cloud.normals)):
        if len(values) not in (0, len(cloud.points)):
            raise InputError(
                f"{name}.{what}: expected one for each of the {len(cloud.points)} points, got {len(values)}"
            )
    if len(cloud.covariances):
        return np.asarray(cloud.covariances)
    normals = np.asarray(cloud.normals) if len(cloud.normals) else None
    return stand_in_covariances(np.asarray(cloud.points), normals, epsilon=thickness, name=f"{name}.points")
