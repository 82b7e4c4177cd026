"""Coarse to fine by the caller's voxel sizes, in place of `o3d.t.pipelines.registration.multi_scale_icp`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from adagmm_o3d.arguments import distance_limit, real_number
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.lazy_open3d import o3d
from adagmm_o3d.options import Callback, CriteriaArgument, DeviceName, EstimationMethod, check_callback, check_criteria
from adagmm_o3d.registration import registration_adaptive_gmm

if TYPE_CHECKING:
    from adagmm_o3d.open3d_results import RegistrationResult, TensorRegistrationResult


def multi_scale_registration_adaptive_gmm(
    source: o3d.geometry.PointCloud | o3d.t.geometry.PointCloud,
    target: o3d.geometry.PointCloud | o3d.t.geometry.PointCloud,
    voxel_sizes: Iterable[float],
    criteria_list: Iterable[CriteriaArgument],
    max_correspondence_distances: Iterable[float],
    init_source_to_target: ArrayLike | o3d.core.Tensor | str | None = None,
    estimation_method: EstimationMethod = None,
    callback_after_iteration: Callback | None = None,
    *,
    device: DeviceName = "auto",
) -> RegistrationResult | TensorRegistrationResult:
    """`registration_adaptive_gmm` at one voxel size after another, each from where the last one ended.

    A drop-in for `o3d.t.pipelines.registration.multi_scale_icp`, for legacy clouds as well. It is coarse to fine by
    itself, so a single call of `registration_adaptive_gmm` is as robust and does less.

    Parameters
    ----------
    source, target : as `registration_adaptive_gmm` has them; covariances and normals are thinned with the points.
    voxel_sizes : (L,) [input units], strictly decreasing, above zero; the last one may be -1: all points.
    criteria_list : (L,) Open3D's ICPConvergenceCriteria or None, one for each size.
    max_correspondence_distances : (L,) [input units] > 0, one for each size; they count and do not choose.
    init_source_to_target, estimation_method, device : as in `registration_adaptive_gmm`; the first for the first size.
    callback_after_iteration : as there, with `scale_index` the number of the size and `iteration_index` running on.

    Returns
    -------
    Open3D's RegistrationResult for the clouds at the last size, `num_iterations` that of all sizes together; `details`
    is the record at the last size.

    Raises
    ------
    InputTypeError, InputError, DegenerateError, DeviceError : one line naming the argument, what was wanted, what came.
    """
    voxels = _listed("voxel_sizes", voxel_sizes)
    criteria = _listed("criteria_list", criteria_list)
    distances = _listed("max_correspondence_distances", max_correspondence_distances)
    for name, values in (("criteria_list", criteria), ("max_correspondence_distances", distances)):
        if len(values) != len(voxels):
            raise InputError(f"{name}: expected one for each of the {len(voxels)} voxel sizes, got {len(values)}")
    _check_voxel_sizes(voxels)
    for level, (one, distance) in enumerate(zip(criteria, distances, strict=True)):
        check_criteria(one, name=f"criteria_list[{level}]")
        distance_limit(f"max_correspondence_distances[{level}]", distance)
    callback = check_callback(callback_after_iteration)
    pose, iterations = init_source_to_target, 0
    for level, (voxel_size, one, distance) in enumerate(zip(voxels, criteria, distances, strict=True)):
        result = registration_adaptive_gmm(
            source,
            target,
            distance,
            pose,
            estimation_method,
            one,
            voxel_size,
            _numbered(callback, level, iterations),
            device=device,
        )
        pose = result.transformation
        iterations += result.details.iterations
    if isinstance(result, o3d.t.pipelines.registration.RegistrationResult):
        result.num_iterations = iterations
    return result


def _listed(name: str, values: Iterable[Any]) -> list[Any]:
    if isinstance(values, (str, dict)) or not isinstance(values, Iterable):
        raise InputTypeError(f"{name}: expected a list, one entry for each voxel size, got {type(values).__name__}")
    return list(values)


def _check_voxel_sizes(voxels: list[Any]) -> None:
    if not voxels:
        raise InputError("voxel_sizes: expected at least one, got none")
    before = math.inf
    for level, value in enumerate(voxels):
        size = real_number(f"voxel_sizes[{level}]", value)
        if size <= 0.0 and level < len(voxels) - 1:
            raise InputError(f"voxel_sizes[{level}]: expected a number > 0 but for the last one, got {size:g}")
        if size >= before:
            raise InputError(f"voxel_sizes[{level}]: expected less than {before:g} before it, got {size:g}")
        before = size


def _numbered(callback: Callback | None, level: int, before: int) -> Callback | None:
    """The callback with the numbers of all sizes; it gets numbers or tensors of one, as the clouds are."""
    if callback is None:
        return None

    def forward(values: dict[str, Any]) -> None:
        index = values["iteration_index"]
        numbers = {"iteration_index": index + before, "scale_index": 0 * index + level, "scale_iteration_index": index}
        callback(values | numbers)

    return forward
