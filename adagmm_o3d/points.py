"""Registration of plain arrays in two or three dimensions; everything else is built on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import ArrayLike

from .em import Criteria, expectation_maximisation
from .errors import InputError
from .kernels.pair_loop import PairLoop
from .mixture import make_mixture, normalise
from .options import DEFAULT_MAX_ITERATION, TransformationEstimationForAdaptiveGMM
from .result import PointRegistrationResult
from .schedule import Annealed, FigureTwo, NearestDistance

# A pose handed over by another program has float32 digits.
INIT_TOLERANCE = 1e-4


def register_points(
    source: ArrayLike,
    target: ArrayLike,
    source_covariances: ArrayLike | None = None,
    target_covariances: ArrayLike | None = None,
    *,
    init: ArrayLike | None = None,
    estimation_method: TransformationEstimationForAdaptiveGMM | None = None,
    criteria: Any = None,
    device: str = "auto",
    callback_after_iteration: Callable[[dict[str, Any]], None] | None = None,
) -> PointRegistrationResult:
    """Register the points `source` onto `target` as adaptive Gaussian mixtures, in 2D or 3D."""
    method = estimation_method or TransformationEstimationForAdaptiveGMM()
    criteria = criteria or o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=DEFAULT_MAX_ITERATION)
    limits = Criteria(criteria.relative_fitness, criteria.relative_rmse, criteria.max_iteration)
    moving = make_mixture("source", source, source_covariances)
    fixed = make_mixture("target", target, target_covariances)
    if moving.dimension != fixed.dimension:
        raise InputError("x")
    D = moving.dimension
    s, t, norm = normalise(moving, fixed)
    start = np.eye(4)
    if init is not None:
        start = norm.pose_in(_lift_pose(np.asarray(init, float), D))
    pairs = PairLoop(s, t)
    rule = {"annealed": lambda: Annealed(D), "nearest": lambda: NearestDistance(D), "figure2": FigureTwo}[
        method.sigma_rule
    ]()
    trace = expectation_maximisation(pairs, start, rule, limits, D, method.relaxation)
    poses = _lower_pose(norm.pose_out(np.array(trace.poses)), D)
    return poses[-1], trace


def _lift_pose(T, D):
    if D == 3:
        return T
    out = np.eye(4)
    out[:2, :2] = T[:2, :2]
    out[:2, 3] = T[:2, 2]
    return out


def _lower_pose(T, D):
    if D == 3:
        return T
    out = np.zeros((len(T), 3, 3))
    out[:, :2, :2] = T[:, :2, :2]
    out[:, :2, 2] = T[:, :2, 3]
    out[:, 2, 2] = 1
    return out
