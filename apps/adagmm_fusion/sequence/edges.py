"""One registration between two frames of a sequence, as an edge of the pose graph."""

from dataclasses import dataclass, replace

import numpy as np

from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.pairs.feature_start import MIN_INLIERS
from adagmm_fusion.pairs.partners import common_partner_distance
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.refinement import see_features
from adagmm_fusion.pairs.settings import Settings
from adagmm_o3d.evaluation import information_matrix, overlap_ratio
from adagmm_o3d.result import LEAST_MARGIN, PointRegistrationResult

# One wrong pose bends the whole path. A pose that the colour images do not confirm therefore needs the first overlap,
# one that they confirm the last only. Where fewer features agree than confirm a pose, but so many as agree with no
# wrong one by chance, the second will do; the pose graph may drop it.
MIN_OVERLAP_ALONE, MIN_OVERLAP_SUPPORTED, MIN_OVERLAP_CONFIRMED = 0.6, 0.4, 0.15
SUPPORTING = 5
# What a pose that is not believed has to overlap to be told to others, which may say the same.
MIN_OVERLAP_TOLD = 0.2
NOT_CONFIRMED = "the colours do not confirm that they show the same place"
# A rig's extrinsics weigh as much as this many point pairs at a metre's distance, which is more than any registration.
RIG_POINTS = 1e5


@dataclass(frozen=True, eq=False)
class Edge:
    """One registration between two frames.

    transformation : (4, 4) T_target_source.    information : (6, 6), as adagmm_o3d.evaluation.information_matrix.
    loop_closure : it may be wrong, and the optimisation may drop it.
    reason : why it cannot be used, or empty. With a pose it is doubtful: by itself it is not believed.
    only_together : it was doubtful, and is believed because others say the same, see `joining`.
    """

    source: int
    target: int
    transformation: np.ndarray | None
    information: np.ndarray | None
    loop_closure: bool
    reason: str = ""
    only_together: bool = False

    @property
    def usable(self) -> bool:
        return not self.reason

    @property
    def doubtful(self) -> bool:
        return bool(self.reason) and self.transformation is not None


def rig_edge(source: int, target: int, T_target_source: np.ndarray) -> Edge:
    """Two sensors of one rig at one moment, by its extrinsics."""
    return Edge(source, target, T_target_source, RIG_POINTS * np.eye(6), False)


def least_overlap(agreeing: int) -> float:
    """The overlap that a pose needs with which so many matched features agree."""
    if agreeing >= MIN_INLIERS:
        return MIN_OVERLAP_CONFIRMED
    return MIN_OVERLAP_SUPPORTED if agreeing >= SUPPORTING else MIN_OVERLAP_ALONE


def registered_edge(
    pair: RGBDPair,
    source: int,
    target: int,
    settings: Settings,
    *,
    loop_closure: bool,
    confirmed_only: bool = False,
    joining: bool = False,
) -> Edge:
    """Register a pair; with `confirmed_only`, only if its colour images agree on a pose that the depth confirms. Where
    it joins two parts, which nothing else would contradict, shape alone does not do.

    Registered and features' poses compete in `register_pair`; no other judge comes after it.
    """

    def refused(reason: str) -> Edge:
        return Edge(source, target, None, None, loop_closure, reason)

    settings = replace(settings, start="features")
    seen = see_features(pair, settings)
    if confirmed_only and seen.believed is None:
        return refused(NOT_CONFIRMED)
    outcome = register_pair(pair, settings, seen=seen)
    if outcome.estimate is None:
        return refused(outcome.reason)
    T = np.asarray(outcome.T_estimate)
    points, onto = np.asarray(outcome.source_cloud.points), np.asarray(outcome.target_cloud.points)
    distance = common_partner_distance(settings)  # one for all edges, as their information counts partners
    overlap = overlap_ratio(points, onto, T, distance)
    confirmed, least = outcome.agreeing_features >= MIN_INLIERS, least_overlap(outcome.agreeing_features)
    reason = "; ".join(outcome.estimate.warnings)
    if not reason and confirmed_only and not confirmed:
        reason = NOT_CONFIRMED
    if not reason and overlap < least:
        reason = f"overlap {overlap:.2f} is below {least:g}{'' if confirmed else ' and the colours do not confirm it'}"
    if not reason and joining and outcome.agreeing_features < SUPPORTING:
        reason = "shape alone joins these parts, by this one registration"
    if reason and (overlap < MIN_OVERLAP_TOLD or not _may_be_confirmed(outcome.estimate)):
        return refused(reason)
    may_be_wrong = loop_closure or (not confirmed and overlap < MIN_OVERLAP_ALONE)
    return Edge(source, target, T, information_matrix(points, onto, distance, T), may_be_wrong, reason)


def _may_be_confirmed(estimate: PointRegistrationResult) -> bool:
    """Whether nothing is said against a pose but that the clouds agree too little, or share too little. What is
    symmetric, or left free, frames side by side get wrong alike."""
    verdict = estimate.weigh()
    symmetric = verdict is not None and (
        verdict.mirrored
        or verdict.repeats
        or verdict.scale is not None
        or (verdict.margin is not None and verdict.margin < LEAST_MARGIN)
    )
    return not estimate.doubts and not estimate.unobservable and not symmetric
