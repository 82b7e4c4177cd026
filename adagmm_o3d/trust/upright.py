"""What is known of a pose when gravity is: a turn about it and a shift are left."""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.result import PoseUncertainty

# A free direction is one of these motions when so much of it is left without the turns that gravity holds.
LEAST_LEFT = 0.5


def held_by_gravity(uncertainty: PoseUncertainty, axis: Array) -> PoseUncertainty:
    """The uncertainty in space on condition that nothing turns but about `axis` (3,), of unit length."""
    allowed = np.eye(6)
    allowed[:3, :3] = np.outer(axis, axis)
    left = [allowed @ direction for direction in uncertainty.unobservable]
    lengths = [float(np.linalg.norm(direction)) for direction in left]
    free = tuple(d / length for d, length in zip(left, lengths, strict=True) if length > LEAST_LEFT)
    if uncertainty.covariance is None:
        return PoseUncertainty(None, free)
    tilts = np.zeros((2, 6))
    tilts[:, :3] = np.linalg.svd(axis[None])[2][1:]
    both = uncertainty.covariance @ tilts.T
    covariance = uncertainty.covariance - both @ np.linalg.pinv(tilts @ both) @ both.T
    return PoseUncertainty(allowed @ covariance @ allowed, free)
