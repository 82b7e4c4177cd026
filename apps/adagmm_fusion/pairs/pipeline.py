"""From recorded pairs to judged registrations. Nothing is printed here, and no failure is hidden."""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import open3d as o3d

from adagmm_fusion.clouds.building import clouds_from_pair
from adagmm_fusion.errors import one_line
from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.pairs.feature_start import MIN_INLIERS, FeatureStart
from adagmm_fusion.pairs.partners import partner_distance
from adagmm_fusion.pairs.refinement import SeenFeatures, refine_pair, see_features
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.pairs.stages import stage_at
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d import registration_adaptive_gmm
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.evaluation import PoseErrors, evaluate_registration, overlap_ratio, pose_errors
from adagmm_o3d.options import DeviceName, TransformationEstimationForAdaptiveGMM
from adagmm_o3d.result import PointRegistrationResult
from adagmm_o3d.warm_up import warm_up

# Colours that differ by no more than a step of 8 bits are one; averages of one colour differ in their last digits.
ONE_SHADE = 1.0 / 255.0
# How much clouds have to overlap, and how much where many features agree with their pose.
MIN_OVERLAP, MIN_OVERLAP_CONFIRMED = 0.3, 0.15

Callback = Callable[[dict], None]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A registration held against the clouds, and the ground truth where it is known.

    partner_distance_m : how near two points count as partners.
    overlap, overlap_truth : share of source points with a partner, at the estimate and at the ground truth; Open3D's
        fitness.
    inlier_rmse_m : root mean square distance of the partners at the estimate.
    initial_errors, errors : against the ground truth, of the identity and of the estimate.
    """

    partner_distance_m: float
    overlap: float
    inlier_rmse_m: float
    overlap_truth: float | None = None
    initial_errors: PoseErrors | None = None
    errors: PoseErrors | None = None


@dataclass(frozen=True, eq=False)
class PairOutcome:
    """What became of one pair.

    status : "ok" or "failed"; `reason` says why it failed.
    judged_by : "ground truth"; "estimate" where that is not known; "error" if the pair could not be registered at all:
        then whatever was not reached is None.
    features : the pose the colour images agreed on, where the registration started; None where the clouds had to do.
    estimate : the registration, with the pose refined by all that both frames measure, see `pairs.refinement`.
    agreeing_features : how many matched features agree with that pose.
    depth_effects : (6, 4) what a standard deviation of the source's and of the target's depth scale and shift do to the
        pose; the estimate's covariance has them, those of one camera together; pairs of the same cameras share them.
    seconds_clouds, seconds_features, seconds_registration : wall time of each step.
    """

    pair_name: str
    index: int
    status: str
    reason: str
    judged_by: str
    pair: RGBDPair | None = None
    source_cloud: o3d.geometry.PointCloud | None = None
    target_cloud: o3d.geometry.PointCloud | None = None
    estimate: PointRegistrationResult | None = None
    evaluation: Evaluation | None = None
    features: FeatureStart | None = None
    agreeing_features: int | None = None
    depth_effects: np.ndarray | None = None
    seconds_clouds: float | None = None
    seconds_features: float | None = None
    seconds_registration: float | None = None

    @property
    def T_estimate(self) -> np.ndarray | None:
        """(4, 4) T_target_source as estimated, or None."""
        return None if self.estimate is None else self.estimate.transformation


def compile_kernels(device: DeviceName) -> None:
    """Register small clouds, so that no pair's time holds the compilation (half a minute, once per machine)."""
    if device != "cuda":
        warm_up(paper_rules=False)
        return
    points = np.random.default_rng(0).normal(size=(1500, 3))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.covariances = o3d.utility.Matrix3dVector(np.tile(np.eye(3), (len(points), 1, 1)))
    registration_adaptive_gmm(cloud, cloud, 0.1, device=device)


def run_pairs(
    recording: Recording, settings: Settings, indices: Iterable[int], callback: Callback | None = None
) -> Iterator[PairOutcome]:
    """Register the pairs with these indices, one after the other; a pair that cannot be is an outcome that says why."""
    for index in indices:
        try:
            pair = recording[index]
        except AdaGMMError as problem:
            yield _refused(recording.pair_name(index), index, problem)
        else:
            yield register_pair(pair, settings, callback)


def register_pair(
    pair: RGBDPair, settings: Settings, callback: Callback | None = None, *, seen: SeenFeatures | None = None
) -> PairOutcome:
    """Make a pair's clouds, register them without any known pose, and judge the result.

    `callback` goes to registration_adaptive_gmm as callback_after_iteration. `seen` are the features, where they have
    been looked at. Errors of ours become a failed outcome.
    """
    reached: dict[str, Any] = {"pair": pair}
    try:
        start = time.perf_counter()
        source, target = clouds_from_pair(
            pair,
            voxel_size=settings.voxel_size_m,
            target_points=settings.target_points,
            sensor_model=settings.sensor_model,
            max_depth=settings.max_depth_m,
        )
        reached |= {"source_cloud": source, "target_cloud": target, "seconds_clouds": time.perf_counter() - start}
        start = time.perf_counter()
        seen = see_features(pair, settings) if seen is None else seen
        reached |= {"features": seen.believed, "seconds_features": time.perf_counter() - start}
        distance = partner_distance(target, settings.partner_distance_m)
        start = time.perf_counter()
        result = registration_adaptive_gmm(
            source,
            target,
            distance,
            estimation_method=TransformationEstimationForAdaptiveGMM(color=_colors_count(source, target, settings)),
            init=None if seen.believed is None else seen.believed.T_target_source,
            criteria=_criteria(settings),
            device=settings.device,
            callback_after_iteration=callback,
            # Each cloud is in the frame of the camera that saw it.
            source_viewpoint=np.zeros(3),
            target_viewpoint=np.zeros(3),
        )
        refined = refine_pair(pair, settings, result.details, seen, source, target)
        reached |= {"estimate": refined.estimate, "agreeing_features": refined.agreeing}
        reached |= {"depth_effects": refined.depth_effects}
        reached |= {"seconds_registration": time.perf_counter() - start}
    except AdaGMMError as problem:
        return _refused(pair.name, pair.index, problem, **reached)
    evaluation = _evaluate(source, target, refined.estimate.transformation, distance, pair.T_target_source)
    reason = why_failed(refined.estimate, evaluation, settings, agreeing_features=refined.agreeing)
    if not reason and evaluation.errors is None:
        contradictions = stage_at(refined.estimate.transformation, pair, source, target, distance).contradictions()
        # One alone may have another cause: what moved, or light that changed.
        reason = " and ".join(contradictions) if len(contradictions) > 1 else ""
    return PairOutcome(
        pair_name=pair.name,
        index=pair.index,
        status="failed" if reason else "ok",
        reason=reason,
        judged_by="estimate" if evaluation.errors is None else "ground truth",
        evaluation=evaluation,
        **reached,
    )


def why_failed(
    estimate: PointRegistrationResult, evaluation: Evaluation, settings: Settings, *, agreeing_features: int = 0
) -> str:
    """Why a registration counts as failed, in one line; empty if it succeeded."""
    errors = evaluation.errors
    if errors is None:
        reasons = list(estimate.warnings)
        least = settings.min_overlap
        if least is None:
            least = MIN_OVERLAP_CONFIRMED if agreeing_features >= MIN_INLIERS else MIN_OVERLAP
        if evaluation.overlap < least:
            reasons.append(f"overlap {evaluation.overlap:.2f} is below {least:g}")
        return "; ".join(reasons)
    reasons, translation_mm = [], 1000.0 * errors.translation
    if errors.rotation_deg > settings.max_rotation_error_deg:
        reasons.append(f"rotation error {errors.rotation_deg:.2f}° is above {settings.max_rotation_error_deg:g}°")
    if translation_mm > settings.max_translation_error_mm:
        reasons.append(f"translation error {translation_mm:.0f} mm is above {settings.max_translation_error_mm:g} mm")
    return "; ".join(reasons)


def _evaluate(
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    T_target_source: np.ndarray,
    distance: float,
    T_truth: np.ndarray | None,
) -> Evaluation:
    points = np.asarray(source.points), np.asarray(target.points)
    known: dict[str, Any] = {}
    if T_truth is not None:
        known = {
            "overlap_truth": overlap_ratio(*points, T_truth, distance),
            "initial_errors": pose_errors(T_truth, np.eye(4)),
            "errors": pose_errors(T_truth, T_target_source),
        }
    found = evaluate_registration(*points, distance, T_target_source)
    return Evaluation(distance, found.fitness, found.inlier_rmse, **known)


def _colors_count(source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud, settings: Settings) -> bool:
    """Whether the colours of both clouds say anything, and may: a depth camera's frames are of one colour."""
    varied = all(np.ptp(np.asarray(cloud.colors)) > ONE_SHADE for cloud in (source, target))
    return settings.color == "auto" and varied


def _criteria(settings: Settings) -> o3d.pipelines.registration.ICPConvergenceCriteria | None:
    if settings.max_iteration is None:
        return None
    return o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=settings.max_iteration)


def _refused(name: str, index: int, problem: AdaGMMError, **reached: Any) -> PairOutcome:
    return PairOutcome(name, index, "failed", one_line(problem), "error", **reached)
