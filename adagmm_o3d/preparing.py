"""`prepare`: a cloud made ready once, for any of the doors."""

from __future__ import annotations

import copy
from typing import Any, overload

from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, real_number
from adagmm_o3d.array_registration import with_covariances
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.kernels.limits import EPSILON
from adagmm_o3d.lazy_open3d import is_installed, o3d
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.prepared import PreparedCloud
from adagmm_o3d.registration import kind_of, ready_legacy
from adagmm_o3d.result import Deferred


@overload
def prepare(
    cloud: o3d.geometry.PointCloud, covariances: None = None, *, voxel_size: float = -1.0, epsilon: float = EPSILON
) -> PreparedCloud[o3d.geometry.PointCloud]: ...


@overload
def prepare(  # type: ignore[overload-cannot-match]  # Open3D's types are skipped here, not by users
    cloud: o3d.t.geometry.PointCloud, covariances: None = None, *, voxel_size: float = -1.0, epsilon: float = EPSILON
) -> PreparedCloud[o3d.t.geometry.PointCloud]: ...


@overload
def prepare(
    cloud: ArrayLike, covariances: ArrayLike | None = None, *, voxel_size: float = -1.0, epsilon: float = EPSILON
) -> PreparedCloud[Array]: ...


def prepare(
    cloud: Any, covariances: ArrayLike | None = None, *, voxel_size: float = -1.0, epsilon: float = EPSILON
) -> PreparedCloud[Any]:
    """Make a cloud ready once, to be registered with many others; to the last bit as if it were not prepared.

    What comes back takes the cloud's place, as source or as target, in `register_points` or
    `registration_adaptive_gmm`. It keeps a copy of the points, the neighbours' covariances and the checked mixture.
    What is made at the scale of a registration (the coarse mixtures, the local features and the order in space) is kept
    while that scale stays the same: it does where the prepared cloud is the larger one of each pair.

    Parameters
    ----------
    cloud : (n, D) points, or a legacy or tensor cloud as `registration_adaptive_gmm` takes it.
    covariances : (n, D, D) of points that are an array, as in `register_points`; clouds have their own.
    voxel_size : [input units] > 0 downsamples a cloud, as in `registration_adaptive_gmm`.
    epsilon : the variance across the surface where a legacy cloud has no covariances, see
        `estimate_surface_covariances`.

    Raises
    ------
    InputTypeError, InputError, DegenerateError : one line naming the argument, what was wanted, what came.
    """
    voxel_size, epsilon = real_number("voxel_size", voxel_size), real_number("epsilon", epsilon)
    if not 0.0 < epsilon <= 1.0:
        raise InputError(f"epsilon: expected 0 < epsilon <= 1, got {epsilon:g}; it is the variance across the surface")
    if isinstance(cloud, PreparedCloud):
        raise InputTypeError("cloud: expected a cloud or an array of points, got one that is prepared")
    kind = kind_of(cloud) if is_installed() else None
    if kind is not None and covariances is not None:
        raise InputError("covariances: expected none beside a cloud, which has its own; set them there")
    if kind == "tensor":
        from adagmm_o3d.tensor_registration import lies_on_gpu, ready_tensor

        tensor = ready_tensor("cloud", cloud.clone(), voxel_size)
        # One that lies on a GPU is checked there, with its first registration.
        if not lies_on_gpu(tensor.cloud):
            tensor.mixture("cloud", make_mixture)
        return tensor
    if kind == "legacy":
        legacy = ready_legacy("cloud", o3d.geometry.PointCloud(cloud), voxel_size, epsilon)
        legacy.mixture("cloud", make_mixture)
        return legacy
    if voxel_size > 0.0:
        raise InputError("voxel_size: expected a cloud of Open3D's to thin, got an array")
    arrays = with_covariances("cloud", *copy.deepcopy((cloud, covariances)))
    points = PreparedCloud(
        "array", arrays[0], Deferred(lambda: arrays), voxel_size, epsilon, given=covariances is not None
    )
    points.mixture("cloud", make_mixture)
    return points
