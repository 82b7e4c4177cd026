"""What is known of a registered pair, gathered for its diagnosis."""

import numpy as np
import open3d as o3d

from adagmm_fusion.pairs.diagnosis import Evidence
from adagmm_fusion.pairs.mirrored import looks_mirrored
from adagmm_fusion.pairs.pipeline import PairOutcome
from adagmm_fusion.pairs.point_diagnostics import PARTNER, points_at_pose
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.pairs.stages import Stage
from adagmm_o3d.result import LEAST_BELIEF, LEAST_EVIDENCE


def evidence_of(outcome: PairOutcome, stages: tuple[Stage, ...], settings: Settings) -> Evidence:
    """The evidence on a pair with its `stages_of`, none if it could not be registered."""
    if not stages:
        return Evidence(outcome.status, outcome.reason)
    _, start, end = stages
    estimate, evaluation, features = outcome.estimate, outcome.evaluation, outcome.features
    moved_mm, across = _motion(outcome, start, end)
    return Evidence(
        outcome.status,
        outcome.reason,
        start,
        end,
        max_rotation_deg=settings.max_rotation_error_deg,
        max_translation_mm=settings.max_translation_error_mm,
        feature_inliers=0 if features is None else features.inliers,
        feature_matches=0 if features is None else features.matches,
        agreeing_features=outcome.agreeing_features,
        overlap_truth=evaluation.overlap_truth,
        moved_mm=moved_mm,
        across=across,
        ambiguous=estimate.ambiguous,
        chance_fit=(estimate.evidence is not None and estimate.evidence < LEAST_EVIDENCE)
        or (estimate.belief is not None and estimate.belief < LEAST_BELIEF),
        converged=estimate.converged,
        free_directions=len(estimate.unobservable),
        mirrored=_mirrored(outcome),
    )


def _motion(outcome: PairOutcome, start: Stage, end: Stage) -> tuple[float, float | None]:
    """How far partners moved from start to end, root mean square [mm], and the share of that across the surfaces."""
    source, target = outcome.source_cloud, outcome.target_cloud
    distance = outcome.evaluation.partner_distance_m
    found = points_at_pose(source, target, np.array(end.T_target_source), distance)
    T = np.array(start.T_target_source)
    steps = found.moved - (np.asarray(source.points) @ T[:3, :3].T + T[:3, 3])
    kept = found.overlap == PARTNER
    if not kept.any():
        return 1000.0 * _rms(np.linalg.norm(steps, axis=1)), None
    steps, length = steps[kept], _rms(np.linalg.norm(steps[kept], axis=1))
    if not target.has_normals() or length == 0:
        return 1000.0 * length, None
    return 1000.0 * length, _rms(_across(steps, target, found.nearest[kept])) / length


def _across(steps: np.ndarray, target: o3d.geometry.PointCloud, nearest: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", steps, np.asarray(target.normals)[nearest])


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _mirrored(outcome: PairOutcome) -> bool:
    """Only looked at where it may be the reason: two sensors, a failure, and features that agree on nothing."""
    pair = outcome.pair
    suspicious = outcome.status != "ok" and outcome.features is None and pair.source.sensor != pair.target.sensor
    return suspicious and looks_mirrored(pair.source, pair.target)
