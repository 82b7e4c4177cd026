"""The stages that every pair goes through, under one name each in the viewer, in report.md and in report.json."""

from dataclasses import dataclass

import numpy as np
import open3d as o3d

from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.pairs.feature_start import FeatureStart
from adagmm_fusion.pairs.point_diagnostics import CONTRADICTED, PARTNER, points_at_pose
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.result import PointRegistrationResult

IDENTITY, START, END = "identity", "start", "end"
FEATURES, GEOMETRY = "features", "geometry"
# An end is worse than its start if one error grew by more than this: less is within what truths are good for.
WORSE_DEG, WORSE_MM = 0.2, 10.0
# Right poses have up to 2 % of their points in front of what the target sees, wrong ones from 5 %.
MANY_CONTRADICTED = 0.05
# Brightness of partners correlates by 0.6 and more at right poses, by 0.15 and less at wrong ones.
COLORS_DISAGREE = 0.35
# Of fewer partners a correlation of colours says nothing.
MIN_COLORED_PARTNERS = 50


@dataclass(frozen=True)
class Stage:
    """One stage of a pair, as report.json has it; None where something is not known.

    stage : "identity", the source as recorded; "start", where the registration was told to begin, or its search left
        off; "end", after registration.
    found_by : "features" or "geometry" of a start, else empty.    T_target_source : (4, 4).
    rotation_error_deg, translation_error_mm : against the ground truth.
    overlap : share of source points with a target point within the partner distance.
    contradicted : share of source points in front of what the target's depth image shows.
    color_correlation : of the brightness of partners, -1 to 1, which exposure and white balance do not change.
    """

    stage: str
    found_by: str
    T_target_source: list[list[float]]
    rotation_error_deg: float | None = None
    translation_error_mm: float | None = None
    overlap: float | None = None
    contradicted: float | None = None
    color_correlation: float | None = None

    @property
    def title(self) -> str:
        """As in "start (features)"."""
        return f"{self.stage} ({self.found_by})" if self.found_by else self.stage

    def contradictions(self) -> list[str]:
        """What the images say against the pose: the target's depth, and the colours of both."""
        found = []
        if self.contradicted is not None and self.contradicted >= MANY_CONTRADICTED:
            found.append(f"{self.contradicted:.0%} of the source lies in front of the target's surfaces")
        if self.color_correlation is not None and self.color_correlation < COLORS_DISAGREE:
            found.append(f"colour contradicts (correlation {self.color_correlation:.2f})")
        return found


def stages_of(
    pair: RGBDPair,
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    estimate: PointRegistrationResult,
    partner_distance_m: float,
    features: FeatureStart | None = None,
) -> tuple[Stage, ...]:
    """The identity, the start and the end of a registered pair, in this order."""
    T_start = estimate.transformations[0] if features is None else features.T_target_source
    found_by = GEOMETRY if features is None else FEATURES
    poses = ((IDENTITY, "", np.eye(4)), (START, found_by, T_start), (END, "", estimate.transformation))
    return tuple(
        stage_at(np.asarray(T), pair, source, target, partner_distance_m, name=name, found_by=found_by)
        for name, found_by, T in poses
    )


def worse_than_start(start: Stage, end: Stage) -> bool:
    """Whether the registration spoilt its start, by the ground truth; never where that is not known."""
    errors = (start.rotation_error_deg, end.rotation_error_deg, start.translation_error_mm, end.translation_error_mm)
    if any(error is None for error in errors):
        return False
    start_deg, end_deg, start_mm, end_mm = errors
    return end_deg > start_deg + WORSE_DEG or end_mm > start_mm + WORSE_MM


def color_correlation(source: np.ndarray, target: np.ndarray) -> float | None:
    """Correlation of the brightness of partners with colours (n, 3) each; None of few, or where all are alike."""
    if len(source) < MIN_COLORED_PARTNERS:
        return None
    a, b = (colors.mean(axis=1) - colors.mean() for colors in (source, target))
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0 else None


def stage_at(
    T: np.ndarray,
    pair: RGBDPair,
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    distance: float,
    *,
    name: str = END,
    found_by: str = "",
) -> Stage:
    """What is known of a pair's clouds at a pose (4, 4), with partners within a distance [m]."""
    found = points_at_pose(source, target, T, distance, pair.target)
    partner = found.overlap == PARTNER
    correlation = None
    if source.has_colors() and target.has_colors():
        theirs = np.asarray(target.colors)[found.nearest[partner]]
        correlation = color_correlation(np.asarray(source.colors)[partner], theirs)
    errors = None if pair.T_target_source is None else pose_errors(pair.T_target_source, T)
    return Stage(
        stage=name,
        found_by=found_by,
        T_target_source=T.tolist(),
        rotation_error_deg=None if errors is None else errors.rotation_deg,
        translation_error_mm=None if errors is None else 1000.0 * errors.translation,
        overlap=float(np.mean(partner)),
        contradicted=float(np.mean(found.overlap == CONTRADICTED)),
        color_correlation=correlation,
    )
