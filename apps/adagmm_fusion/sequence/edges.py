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

# One wrong pose bends the whole path. A pose that the colour images do not confirm therefore needs the first overlap,
# one that they confirm the second only.
MIN_OVERLAP_ALONE, MIN_OVERLAP_CONFIRMED = 0.6, 0.15
# A rig's extrinsics weigh as much as this many point pairs at a metre's distance, which is more than any registration.
RIG_POINTS = 1e5


@dataclass(frozen=True, eq=False)
class Edge:
    """One registration between two frames.

    transformation : (4, 4) T_target_source.    information : (6, 6), as adagmm_o3d.evaluation.information_matrix.
    loop_closure : it may be wrong, and the optimisation may drop it.    reason : why it cannot be used, or empty.
    """

    source: int
    target: int
    transformation: np.ndarray | None
    information: np.ndarray | None
    loop_closure: bool
    reason: str = ""

    @property
    def usable(self) -> bool:
        return not self.reason


def rig_edge(source: int, target: int, T_target_source: np.ndarray) -> Edge:
    """Two sensors of one rig at one moment, by its extrinsics."""
    return Edge(source, target, T_target_source, RIG_POINTS * np.eye(6), False)


def registered_edge(
    pair: RGBDPair, source: int, target: int, settings: Settings, *, loop_closure: bool, confirmed_only: bool = False
) -> Edge:
    """Register a pair; with `confirmed_only`, only if its colour images agree on a pose that the depth confirms.

    Registered and features' poses compete in `register_pair`; no other judge comes after it.
    """

    def refused(reason: str) -> Edge:
        return Edge(source, target, None, None, loop_closure, reason)

    settings = replace(settings, start="features")
    seen = see_features(pair, settings)
    if confirmed_only and seen.believed is None:
        return refused("the colours do not confirm that they show the same place")
    outcome = register_pair(pair, settings, seen=seen)
    if outcome.estimate is None:
        return refused(outcome.reason)
    T = np.asarray(outcome.T_estimate)
    points, onto = np.asarray(outcome.source_cloud.points), np.asarray(outcome.target_cloud.points)
    distance = common_partner_distance(settings)  # one for all edges, as their information counts partners
    overlap = overlap_ratio(points, onto, T, distance)
    confirmed = outcome.agreeing_features >= MIN_INLIERS
    least, but = (MIN_OVERLAP_CONFIRMED, "") if confirmed else (MIN_OVERLAP_ALONE, " and the colours do not confirm it")
    if outcome.estimate.warnings:
        return refused("; ".join(outcome.estimate.warnings))
    if confirmed_only and not confirmed:
        return refused("the colours do not confirm that they show the same place")
    if overlap < least:
        return refused(f"overlap {overlap:.2f} is below {least:g}{but}")
    return Edge(source, target, T, information_matrix(points, onto, distance, T), loop_closure)
