"""Robust rigid registration of point clouds as adaptive Gaussian mixtures, in Open3D's terms."""

from .errors import AdaGMMError, DegenerateError, DeviceError, InputError, InputTypeError
from .forking import keep_working_after_fork
from .options import TransformationEstimationForAdaptiveGMM
from .points import register_points
from .registration import registration_adaptive_gmm
from .result import PointRegistrationResult, StopReason
from .uncertainty import (
    KinectUncertainty,
    estimate_kinect_covariances,
    estimate_nguyen_covariances,
    estimate_surface_covariances,
    mark_outliers,
)

__all__ = [
    "AdaGMMError",
    "DegenerateError",
    "DeviceError",
    "InputError",
    "InputTypeError",
    "KinectUncertainty",
    "PointRegistrationResult",
    "StopReason",
    "TransformationEstimationForAdaptiveGMM",
    "estimate_kinect_covariances",
    "estimate_nguyen_covariances",
    "estimate_surface_covariances",
    "mark_outliers",
    "register_points",
    "registration_adaptive_gmm",
]

keep_working_after_fork()
