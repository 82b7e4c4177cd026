"""How far a point may be from where it was measured, by its covariance at the scale σ: one number, in millimetres.

σ alone has the unit that the covariances leave to it, which differs from one sensor model to another.
"""

import numpy as np
import open3d as o3d

MILLIMETRES_PER_METRE = 1000.0


def point_variance(cloud: o3d.geometry.PointCloud) -> float | None:
    """The median over the points of the mean variance along an axis, Σ without σ; None without covariances."""
    if not cloud.has_covariances():
        return None
    variances = np.trace(np.asarray(cloud.covariances), axis1=1, axis2=2) / 3.0
    known = variances[np.isfinite(variances)]
    return float(np.median(known)) if len(known) else None


def spread_mm(sigmas: np.ndarray, variance: float) -> np.ndarray:
    """Standard deviations of such a point at scales σ [mm]."""
    return MILLIMETRES_PER_METRE * np.sqrt(sigmas * variance)
