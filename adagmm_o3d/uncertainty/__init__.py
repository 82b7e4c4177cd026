"""Covariances of points: from the sensor's noise, from the surface around them, and for points known to be wrong."""

from adagmm_o3d.uncertainty.kinect import KinectUncertainty, estimate_kinect_covariances
from adagmm_o3d.uncertainty.kinect_surface import estimate_kinect_surface_covariances
from adagmm_o3d.uncertainty.lidar import estimate_lidar_covariances
from adagmm_o3d.uncertainty.nguyen2012 import estimate_nguyen_covariances, nguyen_axial_sigma, nguyen_lateral_sigma_px
from adagmm_o3d.uncertainty.outliers import mark_outliers
from adagmm_o3d.uncertainty.surface import estimate_surface_covariances

__all__ = [
    "KinectUncertainty",
    "estimate_kinect_covariances",
    "estimate_kinect_surface_covariances",
    "estimate_lidar_covariances",
    "estimate_nguyen_covariances",
    "estimate_surface_covariances",
    "mark_outliers",
    "nguyen_axial_sigma",
    "nguyen_lateral_sigma_px",
]
