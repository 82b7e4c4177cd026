"""Poses that the registration and the features propose compete before one judge: all that the two frames measure."""

from dataclasses import dataclass

import numpy as np

from adagmm_fusion.measurements.joint_pose import MANY, SOME, JointPose, Measurements, refine
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_inverse

# Poses nearer to each other than both are one candidate: where the first leads, the second does.
SAME_DEG, SAME_M = 0.5, 0.02
# Clearly different poses.
APART_DEG, APART_M = 5.0, 0.15
# Evidence comes and goes with the pixels that are looked at: a refined pose may seem this share worse, and at least
# this much [nats], before the one it came from is kept instead.
LOSS_SHARE, LOSS = 0.05, 2.0
# Features that agree to a pixel do so by no chance, while surfaces slide along each other. So a pose is preferred that
# has at least this many times the evidence of features, and this share of that of surfaces, and at least so much.
MORE_FEATURES, ENOUGH_SURFACE, LEAST_BY_FEATURES = 2.0, 0.3, 60.0


@dataclass(frozen=True, eq=False)
class Winner:
    """The pose that explains most of what is measured.

    joint : the pose and what is known of it.   agreeing : matched features that agree with it.
    lead : by how much it explains more than the best clearly different candidate [nats]; infinite without one.
    """

    joint: JointPose
    agreeing: int
    lead: float


def compete(measurements: Measurements, proposed: list[np.ndarray]) -> Winner:
    """Refine the proposed poses (4, 4), at least one, by all measurements and choose.

    What a pose led to competes with the pose itself, so that refinement makes nothing worse.
    """
    refined: list[np.ndarray] = []
    for pose in proposed:
        if not any(are_near(pose, other, SAME_DEG, SAME_M) for other in refined):
            refined.append(refine(measurements, pose, SOME).T_target_source)
    poses = [*refined, *proposed]
    scale = min(measurements.scale(pose) for pose in poses)
    if not np.isfinite(scale):  # nowhere do the surfaces meet
        scale = 1.0
    evidence = np.array([measurements.evidence(pose, scale) for pose in poses])
    best = _chosen(evidence - np.where(np.arange(len(poses)) < len(refined), 0.0, _loss(evidence))[:, None] / 2.0)
    winner = refine(measurements, poses[best], MANY)
    left = sum(measurements.evidence(winner.T_target_source, scale))
    if left < evidence[best].sum() - _loss(evidence)[best]:
        winner = measurements.known(poses[best])
    T = winner.T_target_source
    apart = [not are_near(pose, T, APART_DEG, APART_M) for pose in poses]
    lead = evidence[best].sum() - evidence[apart].sum(axis=1).max() if any(apart) else np.inf
    return Winner(winner, measurements.agreeing(T), float(lead))


def are_near(a: np.ndarray, b: np.ndarray, rotation_deg: float, distance_m: float) -> bool:
    """Whether two poses (4, 4) differ by less than both limits; by how far the cameras are apart."""
    errors = pose_errors(a, b)
    apart = float(np.linalg.norm(se_inverse(a)[:3, 3] - se_inverse(b)[:3, 3]))
    return errors.rotation_deg < rotation_deg and min(errors.translation, apart) < distance_m


def _loss(evidence: np.ndarray) -> np.ndarray:
    """(n,) how much of (n, 2) evidence may be lost."""
    return np.maximum(LOSS, LOSS_SHARE * np.abs(evidence.sum(axis=1)))


def _chosen(evidence: np.ndarray) -> int:
    """The row of (n, 2) evidence by surfaces and by features that wins."""
    best = int(np.argmax(evidence.sum(axis=1)))
    by_surface, by_features = evidence[best]
    agree = evidence[:, 1] >= max(MORE_FEATURES * by_features, LEAST_BY_FEATURES)
    agree &= evidence[:, 0] >= ENOUGH_SURFACE * by_surface
    if not agree.any():
        return best
    return int(np.argmax(np.where(agree, evidence.sum(axis=1), -np.inf)))
