"""Open3D's feature-based methods, which need no start, alone and refined."""

from __future__ import annotations

import numpy as np
import open3d as o3d
from open3d.pipelines import registration as reg

from adagmm_bench.methods.lifting import open3d_cloud
from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud

FEATURE_VOXEL = 0.08  # radii; best of 0.05 to 0.16 for RANSAC
FAST_GLOBAL_VOXEL = 0.05  # likewise for fast global registration
REFINEMENT_DISTANCES = (0.25, 0.12)  # radii
RANSAC_ITERATIONS = 100_000


def features(cloud: Cloud, voxel: float = FEATURE_VOXEL) -> tuple[o3d.geometry.PointCloud, reg.Feature]:
    """The cloud on a voxel grid, and its fast point feature histograms over five voxels."""
    made = open3d_cloud(cloud).voxel_down_sample(voxel)
    made.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel, max_nn=30))
    made.orient_normals_towards_camera_location(made.get_center())
    return made, reg.compute_fpfh_feature(made, o3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel, max_nn=100))


def refine(source: Cloud, target: Cloud, T: np.ndarray) -> np.ndarray:
    """Generalized ICP on all points from `T`, correspondences within 0.25, then 0.12 radii."""
    moving, fixed = open3d_cloud(source, normals=True), open3d_cloud(target, normals=True)
    for distance in REFINEMENT_DISTANCES:
        T = reg.registration_generalized_icp(moving, fixed, distance, T).transformation
    return T


def _fast_global(source: Cloud, target: Cloud) -> np.ndarray:
    moving, moving_features = features(source, FAST_GLOBAL_VOXEL)
    fixed, fixed_features = features(target, FAST_GLOBAL_VOXEL)
    option = reg.FastGlobalRegistrationOption(
        maximum_correspondence_distance=FAST_GLOBAL_VOXEL, iteration_number=128, maximum_tuple_count=2000
    )
    return reg.registration_fgr_based_on_feature_matching(
        moving, fixed, moving_features, fixed_features, option
    ).transformation


@method("open3d-fgr", library="open3d", dimensions=(3,), anywhere=True)
def fast_global(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D fast global registration on FPFH. Voxel 0.05 radii, feature radius 0.25, correspondence distance 0.05."""
    return _fast_global(source, target)


@method("open3d-fgr-gicp", library="open3d", dimensions=(3,), anywhere=True)
def fast_global_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D fast global registration as above, then generalized ICP within 0.25 and 0.12 radii."""
    return refine(source, target, _fast_global(source, target))


@method("open3d-ransac-gicp", library="open3d", dimensions=(3,), anywhere=True)
def ransac_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D RANSAC on FPFH (voxel 0.08 radii, feature radius 0.4, mutual matches, 3-point samples, edge length check
    0.9, inliers within 0.12, 100 000 iterations, confidence 0.999), then generalized ICP within 0.25 and 0.12 radii.
    """
    (moving, moving_features), (fixed, fixed_features) = features(source), features(target)
    distance = 1.5 * FEATURE_VOXEL
    found = reg.registration_ransac_based_on_feature_matching(
        moving,
        fixed,
        moving_features,
        fixed_features,
        True,
        distance,
        reg.TransformationEstimationPointToPoint(False),
        3,
        [
            reg.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            reg.CorrespondenceCheckerBasedOnDistance(distance),
        ],
        reg.RANSACConvergenceCriteria(RANSAC_ITERATIONS, 0.999),
    )
    return refine(source, target, found.transformation)
