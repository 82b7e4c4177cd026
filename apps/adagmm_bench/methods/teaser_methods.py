"""TEASER++ on mutual FPFH matches, whose Python module teaserpp_python has to be built from its sources."""

from __future__ import annotations

import numpy as np
from open3d.pipelines import registration as reg

from adagmm_bench.methods.open3d_global import FEATURE_VOXEL, features, refine
from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud


@method("teaser-gicp", library="teaserpp_python", dimensions=(3,), anywhere=True)
def teaser_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """TEASER++ on mutual FPFH matches (voxel 0.08 radii), noise bound 0.08, graduated non-convexity with factor 1.4,
    then Open3D generalized ICP within 0.25 and 0.12 radii.
    """
    import teaserpp_python as teaser

    (moving, moving_features), (fixed, fixed_features) = features(source), features(target)
    matches = np.asarray(reg.correspondences_from_features(moving_features, fixed_features, mutual_filter=True))
    parameters = teaser.RobustRegistrationSolver.Params()
    parameters.noise_bound = FEATURE_VOXEL
    parameters.cbar2 = 1.0
    parameters.estimate_scaling = False
    parameters.rotation_estimation_algorithm = teaser.RobustRegistrationSolver.ROTATION_ESTIMATION_ALGORITHM.GNC_TLS
    parameters.rotation_gnc_factor = 1.4
    parameters.rotation_max_iterations = 100
    parameters.rotation_cost_threshold = 1e-12
    solver = teaser.RobustRegistrationSolver(parameters)
    solver.solve(np.asarray(moving.points)[matches[:, 0]].T, np.asarray(fixed.points)[matches[:, 1]].T)
    found = solver.getSolution()
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = found.rotation, np.ravel(found.translation)
    return refine(source, target, T)
