"""Outcomes of registrations of made clouds: whether the pose is right, and whether the result warns."""

import numpy as np

from adagmm_o3d import estimate_surface_covariances, register_points
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_exp

NOISE = 0.005


def twist(rng, dimension, turn, shift=0.05):
    """A motion by a turn of so many radians about any axis, and a small shift."""
    if dimension == 2:
        T = np.eye(3)
        T[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        T[:2, 2] = shift * rng.normal(size=2)
        return T
    axis = rng.normal(size=3)
    return se_exp(np.concatenate([turn * axis / np.linalg.norm(axis), shift * rng.normal(size=3)]))


def noisy(rng, points):
    return points + NOISE * rng.normal(size=points.shape)


def outcome(source, target, T):
    """Whether the pose is right, and whether the result warns of it."""
    covariances = [None, None]
    if len(source) > 500:
        covariances = [estimate_surface_covariances(cloud) for cloud in (source, target)]
    result = register_points(source, target, *covariances)
    if T is None:
        return False, bool(result.warnings), result
    errors = pose_errors(T, result.transformation)
    return errors.rotation_deg < 5.0 and errors.translation < 0.1, bool(result.warnings), result


def misjudged(kind, trials):
    """Of pairs that kind(rng, trial) makes, what is wrong without a warning and what is right with one."""
    silent, alarms = [], []
    for trial in range(trials):
        right, warned, result = outcome(*kind(np.random.default_rng([trial, 16]), trial))
        if not right and not warned:
            silent.append((trial, result.belief, result.evidence))
        if right and warned:
            alarms.append((trial, result.warnings))
    return silent, alarms
