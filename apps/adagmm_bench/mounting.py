"""What is left of rotation errors when the truth may be turned on its mount.

Truth from motion capture or a robot is of a marker or a hand, and comes to the camera by one calibrated rotation.
Where that is off by X, every true rotation R between two frames should have been X R Xᵀ, and all errors have X in
common. It is estimated from the other pairs, so that no pair has a say in its own error; what the pairs do not have in
common is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

# Errors from here on count for less [rad], and with fewer pairs nothing is said of what they have in common.
LARGE, LEAST_PAIRS = 0.005, 8


@dataclass(frozen=True, eq=False)
class MountingErrors:
    """turn_deg : how far the truth has to be turned on its mount, by all pairs.   rotation_error_deg : (n,) what is
    left of each pair's rotation error with the turn that the others say."""

    turn_deg: float
    rotation_error_deg: np.ndarray


def errors_up_to_mounting(truths: np.ndarray, estimates: np.ndarray) -> MountingErrors | None:
    """Of n ≥ LEAST_PAIRS rotations (n, 3, 3) T_target_source each; None of fewer."""
    count = len(truths)
    if count < LEAST_PAIRS:
        return None
    every = np.arange(count)
    left = [
        np.linalg.norm(_off(_turn(truths, estimates, every[every != i]), truths, estimates, every[i : i + 1]))
        for i in every
    ]
    turn = np.linalg.norm(_turn(truths, estimates, every))
    return MountingErrors(float(np.degrees(turn)), np.degrees(left))


def _turn(truths: np.ndarray, estimates: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(3,) the rotation vector of the mount that some pairs agree on."""

    def off(vector: np.ndarray) -> np.ndarray:
        return _off(vector, truths, estimates, rows).ravel()

    return least_squares(off, np.zeros(3), loss="soft_l1", f_scale=LARGE).x


def _off(vector: np.ndarray, truths: np.ndarray, estimates: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(rows, 3) rotation vectors from the turned truths to the estimates."""
    turn = Rotation.from_rotvec(vector)
    turned = turn * Rotation.from_matrix(truths[rows]) * turn.inv()
    return (turned.inv() * Rotation.from_matrix(estimates[rows])).as_rotvec()
