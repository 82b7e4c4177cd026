"""One generated pair registered, as a record for the journal: what was seen, and whether the pose is right."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from adagmm_bench.belief.pairs import BeliefPair, Pair
from adagmm_bench.methods import METHODS
from adagmm_bench.methods.variant import Replacement, replaced
from adagmm_bench.pairs.problem import cloud_of_points, rms_radius
from adagmm_bench.trial import TrialJob, attempt, record_of
from adagmm_o3d import PointRegistrationResult, register_points, registration_adaptive_gmm
from adagmm_o3d.evaluation import rotation_error_deg

# What is seen of each pose whatever is believed of it, so that the weights do not depend on those before.
WHATEVER = (Replacement("trust.verdict", "LOOKED_AT", 0.0),)
SEEN = ("held", "margin", "over_image")
FAR = 9.0  # in place of the infinite margin of a pose without a rival


def run_belief_trial(job: TrialJob[BeliefPair]) -> dict:
    """`seen` is what the signs come from, None where there are none: of few points, or where something else than the
    pose is warned of."""
    pair = job.problem.load()

    def register() -> tuple[np.ndarray, dict]:
        with replaced(WHATEVER):
            result = registered(pair)
            verdict = result.weigh()
        # of another size the pose itself may agree; along a direction that the shape leaves free it may be off
        elsewhere = bool(result.unobservable) or result.scale is not None
        known = verdict is not None and verdict.belief is not None and not elsewhere
        return result.transformation, {
            "seen": [min(getattr(verdict, name), FAR) for name in SEEN] if known else None,
            "right": is_right(pair, result.transformation),
            "warnings": list(result.warnings),
        }

    outcome = attempt(register)[1]
    return record_of(job, METHODS[job.method].version(), **outcome)


def registered(pair: Pair) -> PointRegistrationResult:
    """The result as a script gets it: of Open3D's clouds in space, of arrays in the plane."""
    init = "global" if pair.anywhere else None
    if pair.source.shape[1] == 2:
        return register_points(pair.source, pair.target, *(pair.covariances or (None, None)), init=init)
    source, target = (cloud_of_points(points) for points in (pair.source, pair.target))
    if pair.covariances is not None:
        for cloud, covariances in zip((source, target), pair.covariances, strict=True):
            cloud.covariances = o3d.utility.Matrix3dVector(covariances)
    return registration_adaptive_gmm(source, target, 0.1 * rms_radius(pair.source), init).details


def is_right(pair: Pair, T: np.ndarray) -> bool:
    """Whether a pose (D+1, D+1) takes the source to where it belongs."""
    if pair.T_target_source is None:
        return False
    off = (pair.T_target_source - T) @ np.append(pair.source.mean(axis=0), 1.0)
    degrees, radii = pair.limits
    shift = float(np.linalg.norm(off)) / max(rms_radius(pair.source), rms_radius(pair.target))
    return rotation_error_deg(pair.T_target_source, T) < degrees and shift < radii
