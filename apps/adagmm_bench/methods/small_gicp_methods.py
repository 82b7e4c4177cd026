"""small_gicp, coarse to fine like Open3D's local methods."""

from __future__ import annotations

from typing import Any

import numpy as np

from adagmm_bench.methods.lifting import THIN_HEIGHT, lift, lower
from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud

DISTANCES = (1.0, 0.5, 0.25, 0.12, 0.06)  # radii
VOXELS = (0.5, 0.25, 0.12)  # radii
NO_DOWNSAMPLING = 1e-4  # radii: a grid so fine that every point keeps its own voxel
NEIGHBOURS = 20
CRITERIA = {"num_threads": 1, "max_iterations": 60, "rotation_epsilon": 1e-4, "translation_epsilon": 1e-4}


def _preprocess(cloud: Cloud) -> Any:
    import small_gicp

    return small_gicp.preprocess_points(
        lift(cloud, THIN_HEIGHT).points,
        downsampling_resolution=NO_DOWNSAMPLING,
        num_neighbors=NEIGHBOURS,
        num_threads=1,
    )


@method("small-gicp", library="small_gicp")
def gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """small_gicp generalized ICP on all points, covariances from 20 neighbours. Correspondences within 1.0, 0.5,
    0.25, 0.12, then 0.06 radii, at most 60 iterations each, one thread.
    """
    import small_gicp

    (moving, _), (fixed, tree), T = _preprocess(source), _preprocess(target), np.eye(4)
    for distance in DISTANCES:
        T = small_gicp.align(
            fixed, moving, tree, T, registration_type="GICP", max_correspondence_distance=distance, **CRITERIA
        ).T_target_source
    return lower(T, source.points.shape[1])


@method("small-vgicp", library="small_gicp")
def vgicp(source: Cloud, target: Cloud) -> np.ndarray:
    """small_gicp voxelized generalized ICP, covariances from 20 neighbours. Voxels of 0.5, 0.25, then 0.12 radii, at
    most 60 iterations each, one thread.
    """
    import small_gicp

    (moving, _), (fixed, _), T = _preprocess(source), _preprocess(target), np.eye(4)
    for voxel_size in VOXELS:
        voxels = small_gicp.GaussianVoxelMap(voxel_size)
        voxels.insert(fixed)
        T = small_gicp.align(voxels, moving, T, **CRITERIA).T_target_source
    return lower(T, source.points.shape[1])
