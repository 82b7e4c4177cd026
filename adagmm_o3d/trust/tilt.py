"""Whether the clouds are tilted against each other though gravity, the same axis in both, held their registration: what
their surfaces ask for beyond a turn about it.

A few Gauss-Newton steps of point to plane from the final pose, free to turn any way.
"""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.lie import se_exp
from adagmm_o3d.trust.agreement import Surface
from adagmm_o3d.trust.scale import LEAST_MOVED, LEAST_PAIRS, SURE, blockwise_covariance, meet

STEPS = 6
# Where less than this share of all points has a partner that does not tell.
LEAST_SHARE = 0.5
# What is upright to no more than this has been levelled badly [rad].
NOTICED = math.radians(3.0)


def estimate_tilt(source: Surface, target: Surface, pose: Array, axis: Array) -> float | None:
    """By how much the source is tilted [rad] at about a pose (4, 4) between normalised clouds, whose turn is about
    `axis` (3,), if that is more than NOTICED and surely so; None else, and where too little is shared, or the surfaces
    leave a turn free."""
    spacing = max(source.spacing, target.spacing)
    moved, normals = source.points @ pose[:3, :3].T + pose[:3, 3], source.normals @ pose[:3, :3].T
    upright = axis
    for _ in range(STEPS):
        centre = moved.mean(axis=0)
        met = meet(moved - centre, normals, target, centre, spacing)
        if met.share < LEAST_SHARE or met.alike.sum() < LEAST_PAIRS:
            return None
        off, weights = met.residuals(spacing)
        rows = met.motions()
        hessian = (rows * weights[:, None]).T @ rows
        hessian += 1e-6 * np.trace(hessian) * np.eye(6)
        delta = np.linalg.solve(hessian, rows.T @ (weights * off))
        step = se_exp(delta)
        moved = (moved - centre) @ step[:3, :3].T + step[:3, 3] + centre
        normals, upright = normals @ step[:3, :3].T, step[:3, :3] @ upright
    tilt = math.acos(min(float(upright @ axis), 1.0))
    inverse = np.asarray(np.linalg.inv(hessian), np.float64)
    free = float(np.linalg.eigvalsh(inverse[:3, :3])[-1])
    if tilt <= NOTICED or weights.sum() * free > LEAST_MOVED**-2.0:
        return None
    covariance = blockwise_covariance(inverse, rows * (weights * (off - rows @ delta))[:, None], met.at)
    deviation = math.sqrt(float(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    return tilt if tilt > SURE * deviation else None
