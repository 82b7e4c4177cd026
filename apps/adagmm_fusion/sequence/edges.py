"""One registration between two frames of a sequence, as an edge of the pose graph."""

from dataclasses import dataclass, replace

import numpy as np

from adagmm_fusion.clouds.building import MIN_DEPTH
from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.pairs.feature_start import find_feature_start
from adagmm_fusion.pairs.partners import common_partner_distance
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.sequence.confirmation import depth_confirms, features_confirm
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

    Where they do, the shape may leave directions of the pose free: the features hold those, and if the registration has
    slid along them, the features' own pose is the edge's.
    """

    def refused(reason: str) -> Edge:
        return Edge(source, target, None, None, loop_closure, reason)

    features = find_feature_start(pair, min_depth_m=MIN_DEPTH, max_depth_m=settings.max_depth_m)
    if features is not None and not depth_confirms(features, pair.target, settings.max_depth_m):
        features = None
    if features is None and confirmed_only:
        return refused("the colours do not confirm that they show the same place")
    outcome = register_pair(pair, settings if features is not None else replace(settings, start="geometry"))
    if outcome.estimate is None:
        return refused(outcome.reason)
    T = np.asarray(outcome.T_estimate)
    points, onto = np.asarray(outcome.source_cloud.points), np.asarray(outcome.target_cloud.points)
    distance = common_partner_distance(settings)  # one for all edges, as their information counts partners
    if features is not None:
        if not features_confirm(features, pair.target, T):
            T = features.T_target_source
        overlap = overlap_ratio(points, onto, T, distance)
        if overlap < MIN_OVERLAP_CONFIRMED:
            return refused(f"overlap {overlap:.2f} is below {MIN_OVERLAP_CONFIRMED:g}")
    elif outcome.status != "ok":
        return refused(outcome.reason)
    elif outcome.evaluation.overlap < MIN_OVERLAP_ALONE:
        overlap = outcome.evaluation.overlap
        return refused(f"overlap {overlap:.2f} is below {MIN_OVERLAP_ALONE:g} and the colours do not confirm it")
    return Edge(source, target, T, information_matrix(points, onto, distance, T), loop_closure)
