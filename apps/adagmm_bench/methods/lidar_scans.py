"""Other libraries on LiDAR scans in metres: generalized ICP on the points as they come, within 2 m, then 1 m."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from open3d.pipelines import registration as reg

from adagmm_bench.methods.open3d_local import CRITERIA
from adagmm_bench.methods.registry import method
from adagmm_bench.methods.small_gicp_methods import CRITERIA as SMALL_CRITERIA
from adagmm_bench.methods.small_gicp_methods import NEIGHBOURS, NO_DOWNSAMPLING
from adagmm_bench.problem import Cloud

DISTANCES = (2.0, 1.0)  # m


@method("open3d-gicp-lidar", library="open3d", dimensions=(3,), default=False)
def gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D generalized ICP on all points, its own covariances. Correspondences within 2, then 1 m, at most 60
    iterations each.
    """
    moving, fixed = (o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points)) for cloud in (source, target))
    T = np.eye(4)
    for distance in DISTANCES:
        T = reg.registration_generalized_icp(moving, fixed, distance, T, criteria=CRITERIA).transformation
    return T


@method("small-gicp-lidar", library="small_gicp", dimensions=(3,), default=False)
def small_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """small_gicp generalized ICP on all points, covariances from 20 neighbours, within the same distances, at most 60
    iterations each, one thread.
    """
    import small_gicp

    (moving, _), (fixed, tree) = (
        small_gicp.preprocess_points(
            cloud.points, downsampling_resolution=NO_DOWNSAMPLING, num_neighbors=NEIGHBOURS, num_threads=1
        )
        for cloud in (source, target)
    )
    T = np.eye(4)
    for distance in DISTANCES:
        T = small_gicp.align(
            fixed, moving, tree, T, registration_type="GICP", max_correspondence_distance=distance, **SMALL_CRITERIA
        ).T_target_source
    return T
