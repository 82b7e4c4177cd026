"""A registered pair's pose refined by every measured pixel and matched feature, and what is then to be said of it."""

from dataclasses import dataclass, replace

import numpy as np
import open3d as o3d

from adagmm_fusion.clouds.building import MIN_DEPTH
from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.measurements.features import FeatureMatches, FeatureMeasurements
from adagmm_fusion.measurements.joint_pose import Measurements
from adagmm_fusion.measurements.residuals import LEAST
from adagmm_fusion.measurements.surfaces import SurfaceMeasurements
from adagmm_fusion.pairs.candidates import APART_DEG, APART_M, Winner, are_near, compete
from adagmm_fusion.pairs.feature_start import MIN_INLIERS, FeatureStart, feature_starts, left_behind, match_features
from adagmm_fusion.pairs.partners import partner_distance
from adagmm_fusion.pairs.settings import Settings
from adagmm_o3d.result import Deferred, Partners, PointRegistrationResult

# A clearly different pose that explains all but this much of the evidence [nats] leaves the pair undecided.
UNDECIDED = 10.0


@dataclass(frozen=True, eq=False)
class SeenFeatures:
    """What the colour images have in common: the matches and the poses that some of them agree on; empty if not asked.

    believed : the pose that most agree on, where they are many.
    """

    matches: FeatureMatches
    starts: list[FeatureStart]

    @property
    def believed(self) -> FeatureStart | None:
        return next((start for start in self.starts if start.inliers >= MIN_INLIERS), None)


@dataclass(frozen=True, eq=False)
class RefinedPair:
    """The estimate at the refined pose, and how many matched features agree with it.

    depth_effects : (6, 4) see `depth_errors.pose_effects`.
    """

    estimate: PointRegistrationResult
    agreeing: int
    depth_effects: np.ndarray


def see_features(pair: RGBDPair, settings: Settings) -> SeenFeatures:
    """Match the features of a pair's images, if the settings say so."""
    if settings.start != "features":
        return SeenFeatures(FeatureMatches(np.empty((0, 3)), np.empty((0, 2))), [])
    matches = match_features(pair, min_depth_m=MIN_DEPTH, max_depth_m=settings.max_depth_m)
    return SeenFeatures(matches, feature_starts(matches, pair.target, max_depth_m=settings.max_depth_m))


def refine_pair(
    pair: RGBDPair,
    settings: Settings,
    registered: PointRegistrationResult,
    seen: SeenFeatures,
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
) -> RefinedPair:
    """The registered pose and those of the features, refined by all measurements; the one that explains most."""
    surfaces = SurfaceMeasurements(
        pair, sensor_model=settings.sensor_model, min_depth_m=MIN_DEPTH, max_depth_m=settings.max_depth_m
    )
    features = None
    if len(seen.matches) >= LEAST:
        features = FeatureMeasurements(seen.matches, pair.source.intrinsics, pair.target.intrinsics)
    proposed = [registered.transformation, *(start.T_target_source for start in seen.starts)]
    winner = compete(Measurements(surfaces, features), proposed)
    effects = winner.joint.depth_effects(np.asarray(target.points))
    # One camera is off alike in both frames.
    together = effects[:, :2] + effects[:, 2:] if pair.source.sensor == pair.target.sensor else effects
    left = "" if seen.believed is None else left_behind(seen.believed.inliers, winner.agreeing)
    estimate = _concluded(registered, winner, source, target, together)
    if left:
        estimate = replace(estimate, doubts=(*estimate.doubts, left))
    return RefinedPair(estimate, winner.agreeing, effects)


def _concluded(
    registered: PointRegistrationResult,
    winner: Winner,
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    depth_effects: np.ndarray,
) -> PointRegistrationResult:
    """The registration's result at the winner's pose; `depth_effects` (6, k) add to its covariance.

    What the registration says against its own pose counts where it is still that pose, and where no colour speaks for
    it: many features agree on no pose by chance, and hold what the shape leaves free.
    """
    T = winner.joint.T_target_source
    transformations = registered.transformations.copy()
    transformations[-1] = T
    stayed = are_near(T, registered.transformation, APART_DEG, APART_M)
    by_colour = winner.agreeing >= MIN_INLIERS
    doubts = registered.doubts if stayed and not by_colour else ()
    if winner.lead < UNDECIDED:
        doubts = (*doubts, "another pose explains the measurements nearly as well")
    uncertainty = winner.joint.uncertainty(np.asarray(target.points))
    if stayed and winner.agreeing < LEAST:
        uncertainty = registered.assess()
    if uncertainty.covariance is not None:
        uncertainty = replace(uncertainty, covariance=uncertainty.covariance + depth_effects @ depth_effects.T)
    return replace(
        registered,
        transformation=T,
        transformations=transformations,
        doubts=doubts,
        ambiguous=winner.lead < UNDECIDED,
        find_partners=registered.find_partners if stayed else Deferred(lambda: _partners(source, target, T)),
        compare_colors=registered.compare_colors if stayed else None,
        assess=Deferred(lambda: uncertainty),
        weigh=registered.weigh if stayed and not by_colour else Deferred(lambda: None),
    )


def _partners(source: o3d.geometry.PointCloud, target: o3d.geometry.PointCloud, T: np.ndarray) -> Partners:
    """Which source points have a target point within the partner distance."""
    moved = o3d.geometry.PointCloud(source).transform(T)
    near = np.asarray(moved.compute_point_cloud_distance(target)) < partner_distance(target)
    return Partners(float(near.mean()), near.astype(float))
