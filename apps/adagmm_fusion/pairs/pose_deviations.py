"""How sure a pose is, in numbers that a person reads."""

import numpy as np

from adagmm_o3d.lie import hat


def pose_deviations(covariance: np.ndarray | None, T: np.ndarray) -> tuple[float | None, float | None]:
    """Standard deviations of the rotation [deg] and of where the source sensor is [mm], all axes together."""
    if covariance is None:
        return None, None
    # A perturbation (ω, v) on the left moves the sensor's place t by v + ω × t.
    J = np.hstack((-hat(T[:3, 3]), np.eye(3)))
    rotation = np.degrees(np.sqrt(np.trace(covariance[:3, :3])))
    return float(rotation), 1000.0 * float(np.sqrt(np.trace(J @ covariance @ J.T)))
