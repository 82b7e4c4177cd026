"""Open3D's local methods, each run coarse to fine over the same correspondence distances."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import open3d as o3d
from open3d.pipelines import registration as reg

from adagmm_bench.methods.lifting import lower, open3d_cloud
from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud

DISTANCES = (1.0, 0.5, 0.25, 0.12, 0.06)  # radii, coarse to fine
CRITERIA = reg.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=60)
NDT_VOXELS = (1.0, 0.5, 0.25)  # radii; below that, voxels of a cloud of 1000 points hold fewer than six


def coarse_to_fine(
    align: Callable[..., reg.RegistrationResult], source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud
) -> np.ndarray:
    """The pose after `align(source, target, distance, pose)` at each of DISTANCES, each from where the last ended."""
    T = np.eye(4)
    for distance in DISTANCES:
        T = align(source, target, distance, T).transformation
    return T


@method("open3d-point-to-point", library="open3d")
def point_to_point(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D ICP, point to point. Correspondences within 1.0, 0.5, 0.25, 0.12, then 0.06 radii, at most 60 iterations
    each.
    """
    estimation = reg.TransformationEstimationPointToPoint()
    T = coarse_to_fine(
        lambda s, t, distance, init: reg.registration_icp(s, t, distance, init, estimation, CRITERIA),
        open3d_cloud(source),
        open3d_cloud(target),
    )
    return lower(T, source.points.shape[1])


@method("open3d-point-to-plane", library="open3d")
def point_to_plane(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D ICP, point to plane. Distances as point to point; normals from 20 neighbours (2D: 8)."""
    estimation = reg.TransformationEstimationPointToPlane()
    T = coarse_to_fine(
        lambda s, t, distance, init: reg.registration_icp(s, t, distance, init, estimation, CRITERIA),
        open3d_cloud(source, normals=True),
        open3d_cloud(target, normals=True),
    )
    return lower(T, source.points.shape[1])


@method("open3d-symmetric", library="open3d")
def symmetric(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D symmetric point-to-plane ICP. Distances and normals as point to plane."""
    T = coarse_to_fine(
        lambda s, t, distance, init: reg.registration_symmetric_icp(s, t, distance, init, criteria=CRITERIA),
        open3d_cloud(source, normals=True),
        open3d_cloud(target, normals=True),
    )
    return lower(T, source.points.shape[1])


def _gicp(
    source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud, distance: float, init: np.ndarray
) -> reg.RegistrationResult:
    return reg.registration_generalized_icp(source, target, distance, init, criteria=CRITERIA)


@method("open3d-gicp", library="open3d")
def gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D generalized ICP with its own covariances, from normals (20 neighbours, 2D: 8), epsilon 1e-3. Distances
    as above.
    """
    T = coarse_to_fine(_gicp, open3d_cloud(source, normals=True), open3d_cloud(target, normals=True))
    return lower(T, source.points.shape[1])


@method("open3d-gicp-covariances", library="open3d")
def gicp_covariances(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D generalized ICP given the same covariances as ours. Distances as above."""
    T = coarse_to_fine(_gicp, open3d_cloud(source, covariances=True), open3d_cloud(target, covariances=True))
    return lower(T, source.points.shape[1])


@method("open3d-ndt", library="open3d", dimensions=(3,))
def ndt(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D normal distributions transform. Voxels of 1.0, 0.5, then 0.25 radii, at most 60 iterations each."""
    moving, fixed, T = open3d_cloud(source), open3d_cloud(target), np.eye(4)
    for voxel_size in NDT_VOXELS:
        option = reg.NormalDistributionsTransformOption(voxel_size=voxel_size, max_iteration=60)
        T = reg.registration_ndt(moving, fixed, option, T).transformation
    return T
