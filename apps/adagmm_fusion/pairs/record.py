"""The numbers of one registered pair, plain and small, as the reports hold them."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from adagmm_fusion.pairs.diagnosis import diagnosis
from adagmm_fusion.pairs.evidence import evidence_of
from adagmm_fusion.pairs.pipeline import PairOutcome
from adagmm_fusion.pairs.pose_deviations import pose_deviations
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.pairs.spread import point_variance, spread_mm
from adagmm_fusion.pairs.stages import Stage, stages_of, worse_than_start


@dataclass(frozen=True)
class PairRecord:
    """The numbers of one outcome, without its images and clouds; None where there are none. JSON has these names.

    diagnosis : why it came out so, in one sentence.
    stages : the identity, the start and the end; none of a pair that could not be registered.
    worse_than_start : the end is clearly farther from the ground truth than the start was.
    rotation_deviation_deg, translation_deviation_mm : standard deviations of the rotation and of where the source
        camera is, all axes together, by the estimate's covariance.
    initial_rotation_error_deg, initial_translation_error_mm : those of the stage "identity", under their old names.
    overlap : share of source points with a target point within the partner distance; estimated_overlap : the share that
        the registration itself believes to have a partner.    sigma : the result's, in the unit that the covariances
        leave to it; spread_mm : standard deviation of a point at the end.
    color_deviations, color_lying, color_gain, color_offset : what was learnt of the colours, see
        `adagmm_o3d.result.ColorFit`; None where they did not count.
    """

    pair: str
    index: int
    status: str
    judged_by: str
    reason: str
    diagnosis: str = ""
    stages: tuple[Stage, ...] = ()
    worse_than_start: bool = False
    target: str | None = None
    source: str | None = None
    target_points: int | None = None
    source_points: int | None = None
    T_target_source: list[list[float]] | None = None
    T_target_source_truth: list[list[float]] | None = None
    initial_rotation_error_deg: float | None = None
    initial_translation_error_mm: float | None = None
    rotation_error_frobenius: float | None = None
    rotation_error_deg: float | None = None
    translation_error_mm: float | None = None
    rotation_deviation_deg: float | None = None
    translation_deviation_mm: float | None = None
    partner_distance_mm: float | None = None
    overlap: float | None = None
    overlap_truth: float | None = None
    inlier_rmse_mm: float | None = None
    started_from: str | None = None
    feature_inliers: int | None = None
    feature_matches: int | None = None
    contradicted: float | None = None
    color_correlation: float | None = None
    agreeing_features: int | None = None
    estimated_overlap: float | None = None
    color_deviations: tuple[float, ...] | None = None
    color_lying: float | None = None
    color_gain: tuple[float, ...] | None = None
    color_offset: tuple[float, ...] | None = None
    sigma: float | None = None
    spread_mm: float | None = None
    iterations: int | None = None
    stop_reason: str | None = None
    converged: bool | None = None
    trustworthy: bool | None = None
    warnings: tuple[str, ...] = ()
    seconds_clouds: float | None = None
    seconds_features: float | None = None
    seconds_registration: float | None = None

    def stage(self, name: str) -> Stage | None:
        """The stage of that name, "identity", "start" or "end", if there is one."""
        return next((stage for stage in self.stages if stage.stage == name), None)


def pair_record(outcome: PairOutcome, settings: Settings) -> PairRecord:
    """What the report says about an outcome of a run with these settings."""
    known: dict[str, Any] = {}
    stages = _stages(outcome)
    if stages:
        _, start, end = stages
        known |= {
            "stages": stages,
            "worse_than_start": worse_than_start(start, end),
            "contradicted": end.contradicted,
            "color_correlation": end.color_correlation,
        }
    if outcome.pair is not None:
        target, source, T_truth = outcome.pair.target, outcome.pair.source, outcome.pair.T_target_source
        known |= {"target": f"{target.sensor}/{target.name}", "source": f"{source.sensor}/{source.name}"}
        known["T_target_source_truth"] = None if T_truth is None else np.asarray(T_truth).tolist()
    if outcome.source_cloud is not None:
        known |= {"target_points": len(outcome.target_cloud.points), "source_points": len(outcome.source_cloud.points)}
    if (estimate := outcome.estimate) is not None:
        rotation_deg, translation_mm = pose_deviations(estimate.pose_covariance, estimate.transformation)
        known |= {
            "rotation_deviation_deg": _number(rotation_deg),
            "translation_deviation_mm": _number(translation_mm),
            "T_target_source": np.asarray(estimate.transformation).tolist(),
            "started_from": "clouds" if outcome.features is None else "features",
            "feature_inliers": None if outcome.features is None else outcome.features.inliers,
            "feature_matches": None if outcome.features is None else outcome.features.matches,
            "agreeing_features": outcome.agreeing_features,
            "estimated_overlap": _number(estimate.overlap),
            "sigma": _number(estimate.sigma),
            "spread_mm": _spread_mm(outcome),
            "iterations": int(estimate.iterations),
            "stop_reason": str(estimate.stop_reason),
            "converged": bool(estimate.converged),
            "trustworthy": bool(estimate.trustworthy),
            "warnings": tuple(estimate.warnings),
        }
    if estimate is not None and estimate.color is not None:
        learnt = estimate.color
        for name in ("deviations", "gain", "offset"):
            known[f"color_{name}"] = tuple(float(value) for value in getattr(learnt, name))
        known["color_lying"] = float(learnt.lying)
    if (evaluation := outcome.evaluation) is not None:
        known |= {
            "partner_distance_mm": _number(1000.0 * evaluation.partner_distance_m),
            "overlap": _number(evaluation.overlap),
            "overlap_truth": _number(evaluation.overlap_truth),
            "inlier_rmse_mm": _number(1000.0 * evaluation.inlier_rmse_m),
        }
        if evaluation.errors is not None:
            known |= {
                "initial_rotation_error_deg": _number(evaluation.initial_errors.rotation_deg),
                "initial_translation_error_mm": _number(1000.0 * evaluation.initial_errors.translation),
                "rotation_error_frobenius": _number(evaluation.errors.rotation_frobenius),
                "rotation_error_deg": _number(evaluation.errors.rotation_deg),
                "translation_error_mm": _number(1000.0 * evaluation.errors.translation),
            }
    return PairRecord(
        pair=outcome.pair_name,
        index=outcome.index,
        status=outcome.status,
        judged_by=outcome.judged_by,
        reason=outcome.reason,
        diagnosis=diagnosis(evidence_of(outcome, stages, settings)),
        seconds_clouds=outcome.seconds_clouds,
        seconds_features=outcome.seconds_features,
        seconds_registration=outcome.seconds_registration,
        **known,
    )


def _stages(outcome: PairOutcome) -> tuple[Stage, ...]:
    if outcome.estimate is None or outcome.evaluation is None:
        return ()
    distance_m = outcome.evaluation.partner_distance_m
    clouds = outcome.source_cloud, outcome.target_cloud
    return stages_of(outcome.pair, *clouds, outcome.estimate, distance_m, outcome.features)


def _spread_mm(outcome: PairOutcome) -> float | None:
    variance = None if outcome.source_cloud is None else point_variance(outcome.source_cloud)
    if variance is None or outcome.estimate is None:
        return None
    return _number(float(spread_mm(np.array(outcome.estimate.sigma), variance)))


def _number(value: float | None) -> float | None:
    """A plain float, None where it is missing or not finite: JSON has no NaN."""
    return None if value is None or not math.isfinite(value) else float(value)
