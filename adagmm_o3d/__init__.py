"""Robust rigid registration of point clouds as adaptive Gaussian mixtures, in Open3D's terms."""

from adagmm_o3d.array_registration import register_points
from adagmm_o3d.batch import register_batch
from adagmm_o3d.errors import AdaGMMError, DegenerateError, DeviceError, InputError, InputTypeError, MissingLibraryError
from adagmm_o3d.kernels.forking import keep_working_after_fork
from adagmm_o3d.multi_scale import multi_scale_registration_adaptive_gmm
from adagmm_o3d.options import Criteria, TransformationEstimationForAdaptiveGMM
from adagmm_o3d.prepared import PreparedCloud
from adagmm_o3d.preparing import prepare
from adagmm_o3d.registration import registration_adaptive_gmm
from adagmm_o3d.result import PointRegistrationResult, StopReason
from adagmm_o3d.uncertainty import (
    KinectUncertainty,
    estimate_kinect_covariances,
    estimate_kinect_surface_covariances,
    estimate_lidar_covariances,
    estimate_nguyen_covariances,
    estimate_surface_covariances,
    mark_outliers,
)
from adagmm_o3d.version import __version__

__all__ = [
    "AdaGMMError",
    "Criteria",
    "DegenerateError",
    "DeviceError",
    "InputError",
    "InputTypeError",
    "KinectUncertainty",
    "MissingLibraryError",
    "PointRegistrationResult",
    "PreparedCloud",
    "StopReason",
    "TransformationEstimationForAdaptiveGMM",
    "__version__",
    "estimate_kinect_covariances",
    "estimate_kinect_surface_covariances",
    "estimate_lidar_covariances",
    "estimate_nguyen_covariances",
    "estimate_surface_covariances",
    "mark_outliers",
    "multi_scale_registration_adaptive_gmm",
    "prepare",
    "register_batch",
    "register_points",
    "registration_adaptive_gmm",
]

keep_working_after_fork()
