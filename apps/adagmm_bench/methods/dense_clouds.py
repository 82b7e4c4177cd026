"""Other libraries on clouds of tens of thousands of points: features and GICP on voxel grids, coarse to fine.

Clouds come in metres where they are rooms, in RMS radii otherwise. The settings are those that are usual for rooms.
"""

from __future__ import annotations

import numpy as np
import open3d as o3d
from open3d.pipelines import registration as reg

from adagmm_bench.methods.open3d_global import RANSAC_ITERATIONS
from adagmm_bench.methods.open3d_local import CRITERIA
from adagmm_bench.methods.registry import method
from adagmm_bench.methods.small_gicp_methods import CRITERIA as SMALL_CRITERIA
from adagmm_bench.methods.small_gicp_methods import NEIGHBOURS
from adagmm_bench.problem import Cloud
from adagmm_o3d.errors import InputError

FEATURE_VOXEL = 0.05
MATCHED = 1.5 * FEATURE_VOXEL  # how near matches of features lie, and correspondences of the refinement
PYRAMID = ((0.2, 1.0), (0.1, 0.5), (0.05, 0.25), (0.025, 0.12), (0.02, 0.06))  # voxel, correspondence distance


def _thinned(cloud: Cloud, voxel: float) -> o3d.geometry.PointCloud:
    """The cloud on a voxel grid, with normals that look at the viewpoint, or at its centre where none is known."""
    made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points)).voxel_down_sample(voxel)
    made.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel, max_nn=30))
    made.orient_normals_towards_camera_location(made.get_center() if cloud.viewpoint is None else cloud.viewpoint)
    return made


def _features(cloud: o3d.geometry.PointCloud) -> reg.Feature:
    return reg.compute_fpfh_feature(cloud, o3d.geometry.KDTreeSearchParamHybrid(radius=5 * FEATURE_VOXEL, max_nn=100))


@method("open3d-ransac-gicp-dense", library="open3d", dimensions=(3,), anywhere=True, default=False)
def ransac_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D RANSAC on FPFH (voxel 0.05, feature radius 0.25, mutual matches, 3-point samples, edge length check 0.9,
    inliers within 0.075, 100 000 iterations, confidence 0.999), then generalized ICP within 0.075 on the same voxels.
    """
    moving, fixed = _thinned(source, FEATURE_VOXEL), _thinned(target, FEATURE_VOXEL)
    found = reg.registration_ransac_based_on_feature_matching(
        moving,
        fixed,
        _features(moving),
        _features(fixed),
        True,
        MATCHED,
        reg.TransformationEstimationPointToPoint(False),
        3,
        [reg.CorrespondenceCheckerBasedOnEdgeLength(0.9), reg.CorrespondenceCheckerBasedOnDistance(MATCHED)],
        reg.RANSACConvergenceCriteria(RANSAC_ITERATIONS, 0.999),
    )
    return reg.registration_generalized_icp(moving, fixed, MATCHED, found.transformation).transformation


@method("kiss-matcher-gicp-dense", library="kiss_matcher", dimensions=(3,), anywhere=True, default=False)
def kiss_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """KISS-Matcher, voxel 0.05, its other settings as they come, then generalized ICP as after RANSAC."""
    import kiss_matcher

    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(FEATURE_VOXEL))
    found = matcher.estimate(source.points.astype(np.float32), target.points.astype(np.float32))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = found.rotation, np.ravel(found.translation)
    if not np.isfinite(T).all():
        raise InputError("kiss-matcher: the pose is not finite")
    moving, fixed = _thinned(source, FEATURE_VOXEL), _thinned(target, FEATURE_VOXEL)
    return reg.registration_generalized_icp(moving, fixed, MATCHED, T).transformation


@method("open3d-gicp-dense", library="open3d", dimensions=(3,), default=False)
def gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """Open3D generalized ICP on voxels of 0.2, 0.1, 0.05, 0.025, then 0.02, correspondences within 1.0, 0.5, 0.25,
    0.12, then 0.06, at most 60 iterations each.
    """
    T = np.eye(4)
    for voxel, distance in PYRAMID:
        moving, fixed = _thinned(source, voxel), _thinned(target, voxel)
        T = reg.registration_generalized_icp(moving, fixed, distance, T, criteria=CRITERIA).transformation
    return T


@method("small-gicp-dense", library="small_gicp", dimensions=(3,), default=False)
def small_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """small_gicp generalized ICP on the same voxels within the same distances, covariances from 20 neighbours, at most
    60 iterations each, one thread.
    """
    import small_gicp

    T = np.eye(4)
    for voxel, distance in PYRAMID:
        (moving, _), (fixed, tree) = (
            small_gicp.preprocess_points(
                cloud.points, downsampling_resolution=voxel, num_neighbors=NEIGHBOURS, num_threads=1
            )
            for cloud in (source, target)
        )
        T = small_gicp.align(
            fixed, moving, tree, T, registration_type="GICP", max_correspondence_distance=distance, **SMALL_CRITERIA
        ).T_target_source
    return T
