"""Tensor point clouds: the same registration with the manners of `o3d.t.pipelines.registration.icp`."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike, NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.array_registration import checked_viewpoints, register_points
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.kernels.cuda.availability import obstacle
from adagmm_o3d.kernels.limits import EPSILON
from adagmm_o3d.mixtures.colours import checked_colors
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.open3d_results import TensorRegistrationResult
from adagmm_o3d.options import (
    Callback,
    CriteriaArgument,
    DeviceName,
    TransformationEstimationForAdaptiveGMM,
    check_criteria,
)
from adagmm_o3d.pairs.device import check_device
from adagmm_o3d.prepared import PreparedCloud
from adagmm_o3d.result import Answer, Deferred, PointRegistrationResult
from adagmm_o3d.uncertainty.surface import stand_in_covariances

TensorCloud: TypeAlias = o3d.t.geometry.PointCloud

# Open3D numbers the voxels along an axis in 32 bits.
MOST_VOXELS = 2.0**31 - 1.0
_log = logging.getLogger("adagmm_o3d")
# Where the colours of a cloud are, or else its intensities.
COLORS = "colors", "intensity"
INTEGER_KEYS = ("iteration_index", "scale_index", "scale_iteration_index")


def register_tensor_clouds(
    source: TensorCloud | PreparedCloud[TensorCloud],
    target: TensorCloud | PreparedCloud[TensorCloud],
    max_correspondence_distance: float,
    init: ArrayLike | str | None,
    method: TransformationEstimationForAdaptiveGMM,
    criteria: CriteriaArgument,
    voxel_size: float,
    device: DeviceName,
    callback_after_iteration: Callback | None,
    viewpoints: tuple[ArrayLike | None, ArrayLike | None],
) -> TensorRegistrationResult:
    """See `registration_adaptive_gmm`, whose arguments these are; they are checked there."""
    moving, fixed = (cloud.cloud if isinstance(cloud, PreparedCloud) else cloud for cloud in (source, target))
    if moving.device != fixed.device:
        raise InputError(
            f"target: expected on the device of source, {moving.device}, got {fixed.device}; move one with .to()"
        )
    for name, cloud in (("source", moving), ("target", fixed)):
        _check_positions(name, cloud)
    wanted, got = moving.point.positions.dtype, fixed.point.positions.dtype
    if wanted != got:
        raise InputTypeError(
            f"target.point.positions: expected {wanted} as the source has, got {got}; convert with .to()"
        )
    sides = _made_ready("source", source, voxel_size), _made_ready("target", target, voxel_size)
    register = _register_in_place if _stays_in_place(moving, device) else register_points
    details = register(
        *sides,
        init=init,
        estimation_method=method,
        criteria=criteria,
        device=device,
        source_viewpoint=viewpoints[0],
        target_viewpoint=viewpoints[1],
        source_colors=_colors(sides[0].cloud) if method.color else None,
        target_colors=_colors(sides[1].cloud) if method.color else None,
        callback_after_iteration=_as_tensors(callback_after_iteration),
    )
    transformation = o3d.core.Tensor(details.transformation)
    evaluated = _evaluated(sides[0].cloud, sides[1].cloud, max_correspondence_distance, transformation)
    result = TensorRegistrationResult()
    result.transformation = transformation
    result.fitness = evaluated.fitness
    result.inlier_rmse = evaluated.inlier_rmse
    result.correspondence_set = evaluated.correspondence_set
    result.converged = details.converged
    result.num_iterations = details.iterations
    result.details = details
    return result


def _made_ready(
    name: str, cloud: TensorCloud | PreparedCloud[TensorCloud], voxel_size: float
) -> PreparedCloud[TensorCloud]:
    if isinstance(cloud, PreparedCloud):
        cloud.check_made_with(name, voxel_size, None)
        return cloud
    return ready_tensor(name, cloud, voxel_size)


def ready_tensor(name: str, cloud: TensorCloud, voxel_size: float) -> PreparedCloud[TensorCloud]:
    """A tensor cloud ready to be registered, thinned where `voxel_size` is above zero; without a copy where not."""
    _check_positions(name, cloud)
    ready = _thinned(name, cloud, voxel_size) if voxel_size > 0.0 else cloud
    arrays = Deferred(lambda: (ready.point.positions.cpu().numpy(), _covariances(name, ready)))
    return PreparedCloud("tensor", ready, arrays, voxel_size, EPSILON, given="covariances" in cloud.point)


def _evaluated(
    source: TensorCloud, target: TensorCloud, distance: float, transformation: o3d.core.Tensor
) -> o3d.t.pipelines.registration.RegistrationResult:
    """Open3D's `evaluate_registration`, which on the CPU looks at every pair of points within the distance."""
    # Only the positions count; what else a cloud has Open3D would move as well, which it refuses for whole numbers.
    (source, seen), (target, known) = (_finite(TensorCloud(cloud.point.positions)) for cloud in (source, target))
    moved = source.clone().transform(transformation).point.positions
    if distance < math.inf and lies_on_gpu(source):
        result = o3d.t.pipelines.registration.evaluate_registration(source, target, distance, transformation)
    else:
        index = o3d.core.nns.NearestNeighborSearch(target.point.positions)
        index.knn_index()
        nearest, squares = index.knn_search(moved, 1)
        nearest = nearest.to(o3d.core.int64)
        if distance < math.inf:
            nearest[squares >= distance * distance] = -1
        result = o3d.t.pipelines.registration.RegistrationResult()
        result.correspondence_set = nearest
    partners = result.correspondence_set.cpu().numpy().ravel()
    paired = np.flatnonzero(partners >= 0)
    result.fitness = len(paired) / len(seen)
    # Open3D adds up in an order that depends on the number of threads.
    start, end = (cloud.cpu().numpy().astype(float) for cloud in (moved, target.point.positions))
    squares = np.sum((start[paired] - end[partners[paired]]) ** 2, axis=1)
    result.inlier_rmse = math.sqrt(squares.mean()) if len(paired) else 0.0
    if not (seen.all() and known.all()):
        among_all = np.full((len(seen), *result.correspondence_set.shape[1:]), -1)
        among_all[np.flatnonzero(seen)[paired]] = np.flatnonzero(known)[result.correspondence_set.cpu().numpy()[paired]]
        result.correspondence_set = o3d.core.Tensor(among_all, device=moved.device)
    return result


def _finite(cloud: TensorCloud) -> tuple[TensorCloud, NDArray[np.bool_]]:
    """The points that are finite, and (n,) which they are."""
    finite, mask = cloud.remove_non_finite_points()
    return finite, mask.cpu().numpy()


def lies_on_gpu(cloud: TensorCloud) -> bool:
    """Whether the cloud's memory is that of a CUDA device."""
    return bool(cloud.is_cuda)


def _stays_in_place(cloud: TensorCloud, device: DeviceName) -> bool:
    """Whether the clouds lie on a GPU and are registered there, as they are unless device="cpu" asks otherwise."""
    if not lies_on_gpu(cloud) or device == "cpu":
        return False
    check_device(device)
    if (reason := obstacle()) is not None:
        _log.warning("the clouds on %s are registered by way of the host: %s", cloud.device, reason)
        return False
    return True


def _register_in_place(
    source: PreparedCloud[TensorCloud],
    target: PreparedCloud[TensorCloud],
    *,
    init: ArrayLike | str | None,
    estimation_method: TransformationEstimationForAdaptiveGMM,
    criteria: CriteriaArgument,
    device: DeviceName,
    source_viewpoint: ArrayLike | None,
    target_viewpoint: ArrayLike | None,
    source_colors: ArrayLike | None,
    target_colors: ArrayLike | None,
    callback_after_iteration: Callback | None,
) -> PointRegistrationResult:
    """As `register_points`, whose arguments it takes, on the device that the clouds are on; no point leaves it."""
    from adagmm_o3d.kernels.cuda.clouds.tensors import current_device
    from adagmm_o3d.search.register import register_mixtures

    limits, seen_from = check_criteria(criteria), checked_viewpoints(source_viewpoint, target_viewpoint, dimension=3)
    here = current_device(source.cloud.point.positions)
    with here:
        moving, fixed = mixture_in_place("source", source), mixture_in_place("target", target)
        kept = moving.kept, fixed.kept
        colors = checked_colors(source_colors, target_colors, kept, needed=estimation_method.color)
        if colors is not None:
            moving, fixed = moving.coloured(colors[0]), fixed.coloured(colors[1])
        details = register_mixtures(
            moving, fixed, init, estimation_method, limits, device, callback_after_iteration, seen_from
        )

    def answered_here(ask: Deferred[Answer]) -> Deferred[Answer]:
        def answer() -> Answer:
            with here:  # by then another device may be the current one
                return ask()

        return Deferred(answer)

    return replace(
        details,
        find_partners=answered_here(details.find_partners),
        assess=answered_here(details.assess),
        weigh=answered_here(details.weigh),
        compare_colors=None if details.compare_colors is None else answered_here(details.compare_colors),
    )


def mixture_in_place(name: str, ready: PreparedCloud[TensorCloud]) -> Mixture:
    """The mixture of a cloud on the device that it lies on, which is the current one."""
    from adagmm_o3d.kernels.cuda.clouds.tensors import on_the_device
    from adagmm_o3d.mixtures.device_mixture import device_mixture

    def make() -> Mixture:
        covariances = _covariances_in_place(name, ready.cloud)
        positions = on_the_device(ready.cloud.point.positions)
        return device_mixture(name, positions, None if covariances is None else on_the_device(covariances))

    return ready.kept_mixture("in place", make)


def _covariances_in_place(name: str, cloud: TensorCloud) -> o3d.core.Tensor | None:
    """Covariances as Float32 or Float64, where the cloud has any or has normals."""
    covariances = _known_covariances(name, cloud)
    if covariances is None:
        return None
    if covariances.dtype == o3d.core.bool:
        raise InputTypeError(f"{name}.covariances: expected an array of real numbers, got dtype bool")
    if covariances.dtype not in (o3d.core.float32, o3d.core.float64):
        covariances = covariances.to(o3d.core.float64)
    return covariances


def _known_covariances(name: str, cloud: TensorCloud) -> o3d.core.Tensor | None:
    """The cloud's own, or those along its normals; None where it has neither."""
    if "covariances" in cloud.point:
        return cloud.point.covariances
    if "normals" not in cloud.point:
        return None
    _check_shape(name, "normals", cloud, (3,))
    normals = cloud.point.normals.to(o3d.core.float64)
    lengths = (normals * normals).sum(dim=1, keepdim=True).sqrt()
    if lies_on_gpu(cloud) and bool((lengths > 0.0).logical_and(lengths.isfinite()).all()):
        normals = normals / lengths
        across = o3d.core.Tensor(1.0 - EPSILON, o3d.core.float64, normals.device)
        products = normals.reshape((-1, 3, 1)) * normals.reshape((-1, 1, 3))
        return o3d.core.Tensor.eye(3, o3d.core.float64, normals.device) - across * products
    # What neighbours have to say of points without a normal, the host finds out.
    covariances = stand_in_covariances(_positions(cloud), normals.cpu().numpy(), name=f"{name}.points")
    return None if covariances is None else o3d.core.Tensor(covariances, device=cloud.device)


def _check_positions(name: str, cloud: TensorCloud) -> None:
    if "positions" not in cloud.point:
        raise InputError(f"{name}.point.positions: the cloud is empty; registration needs at least 3 points")
    dtype = cloud.point.positions.dtype
    if dtype not in (o3d.core.float32, o3d.core.float64):
        raise InputTypeError(f"{name}.point.positions: expected Float32 or Float64, got {dtype}")


def check_voxel_size(name: str, low: Array, high: Array, voxel_size: float) -> None:
    """Raise where a cloud between two corners would have more voxels along an axis than Open3D can number."""
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        return
    extent = float(np.max(high - low))
    if extent / voxel_size >= MOST_VOXELS:
        raise InputError(
            f"voxel_size: expected more than {extent / MOST_VOXELS:.3g} for the extent {extent:.3g} of {name}, "
            f"got {voxel_size:g}"
        )


def _thinned(name: str, cloud: TensorCloud, voxel_size: float) -> TensorCloud:
    """Voxel averages of the positions and of the covariances; Open3D averages attributes of one row a point only.

    Normals become covariances first: the mean of two that point to opposite sides means nothing.
    """
    cloud, _ = _finite(cloud)
    if len(cloud.point.positions):
        low, high = (corner.cpu().numpy() for corner in (cloud.get_min_bound(), cloud.get_max_bound()))
        check_voxel_size(name, low, high, voxel_size)
    flat = TensorCloud(cloud.point.positions)
    if (covariances := _known_covariances(name, cloud)) is not None:
        if "covariances" in cloud.point:
            _check_shape(name, "covariances", cloud, (3, 3))
        flat.point.covariances = covariances.reshape((-1, 9))
    for what in COLORS:
        if what in cloud.point:
            # uint8 would be averaged in whole numbers; the door takes them for a 255th.
            flat.point[what] = cloud.point[what].to(o3d.core.float32) / _white(cloud, what)
    thinned = flat.voxel_down_sample(voxel_size)
    if "covariances" in thinned.point:
        thinned.point.covariances = thinned.point.covariances.reshape((-1, 3, 3))
    return thinned


def _covariances(name: str, cloud: TensorCloud) -> Array | None:
    known = _known_covariances(name, cloud)
    if known is not None:
        return known.cpu().numpy()
    return stand_in_covariances(_positions(cloud), name=f"{name}.points")


def _positions(cloud: TensorCloud) -> Array:
    """(n, 3) float64 on the host."""
    return np.asarray(cloud.point.positions.cpu().numpy(), np.float64)


def _white(cloud: TensorCloud, what: str) -> float:
    """What the brightest colour is written as."""
    return 255.0 if what == "colors" and cloud.point[what].dtype == o3d.core.uint8 else 1.0


def _colors(cloud: TensorCloud) -> NDArray[Any] | None:
    """(n, 3) colours or (n, 1) intensities; None where the cloud has neither."""
    found = next((what for what in COLORS if what in cloud.point), None)
    return None if found is None else cloud.point[found].cpu().numpy()


def _check_shape(name: str, what: str, cloud: TensorCloud, row: tuple[int, ...]) -> None:
    wanted, got = (len(cloud.point.positions), *row), tuple(cloud.point[what].shape)
    if got != wanted:
        raise InputError(f"{name}.{what}: expected shape {wanted}, got {got}")


def _as_tensors(callback: Callback | None) -> Callback | None:
    """Open3D's tensor callback gets a dictionary of tensors: indices Int64, the rest Float64, on the CPU."""
    if callback is None:
        return None

    def forward(values: dict[str, Any]) -> None:
        callback(
            {
                key: o3d.core.Tensor(np.asarray(value), o3d.core.int64 if key in INTEGER_KEYS else o3d.core.float64)
                for key, value in values.items()
            }
        )

    return forward
