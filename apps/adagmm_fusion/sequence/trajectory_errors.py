"""How far an estimated trajectory is from the true one: ATE and RPE as evo defines them.

Source: Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012; evo's `evo_ape tum --align` and
`evo_rpe tum --delta 1 --delta_unit f`; S. Umeyama, Least-squares estimation of transformation parameters, PAMI 1991.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import rotation_error_deg
from adagmm_o3d.lie import se_inverse


@dataclass(frozen=True)
class TrajectoryErrors:
    """Root mean squares over a trajectory.

    ate_m : distance of the positions, after the rigid alignment that makes it smallest.
    rpe_m, rpe_deg : error of the motion from each pose to the next.    poses : how many were compared.
    """

    ate_m: float
    rpe_m: float
    rpe_deg: float
    poses: int


def trajectory_errors(T_true: np.ndarray, T_est: np.ndarray) -> TrajectoryErrors:
    """Compare (N, 4, 4) true and estimated T_world_camera of the same moments, N at least 3; the worlds may differ.

    Raises
    ------
    InputError  if the shapes are others.
    """
    T_true, T_est = np.asarray(T_true, dtype=float), np.asarray(T_est, dtype=float)
    if T_true.shape != T_est.shape or T_true.shape[1:] != (4, 4) or len(T_true) < 3:
        raise InputError(f"T_true, T_est: expected (N, 4, 4) of one N >= 3, got {T_true.shape} and {T_est.shape}")
    T = align_rigid(T_est[:, :3, 3], T_true[:, :3, 3])
    aligned = T_est[:, :3, 3] @ T[:3, :3].T + T[:3, 3]
    relative = [
        se_inverse(se_inverse(T_true[i]) @ T_true[i + 1]) @ se_inverse(T_est[i]) @ T_est[i + 1]
        for i in range(len(T_true) - 1)
    ]
    return TrajectoryErrors(
        ate_m=_rms(np.linalg.norm(aligned - T_true[:, :3, 3], axis=1)),
        rpe_m=_rms([np.linalg.norm(E[:3, 3]) for E in relative]),
        rpe_deg=_rms([rotation_error_deg(np.eye(4), E) for E in relative]),
        poses=len(T_true),
    )


def align_rigid(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """The (4, 4) rigid transformation that brings (N, 3) points nearest to their partners, by least squares."""
    mean_points, mean_onto = points.mean(axis=0), onto.mean(axis=0)
    # Points on a line leave a turn about it free, and any will do: project_to_rotation() would refuse them.
    left, _, right = np.linalg.svd((onto - mean_onto).T @ (points - mean_points))
    T = np.eye(4)
    T[:3, :3] = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    T[:3, 3] = mean_onto - T[:3, :3] @ mean_points
    return T


def _rms(values: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
