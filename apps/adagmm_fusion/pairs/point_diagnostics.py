"""Why a registration went as it did, point by point: who pulls, how far off each is, who can have a partner."""

from dataclasses import dataclass

import numpy as np
import open3d as o3d
from scipy.spatial import cKDTree

from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_fusion.pairs import partners
from adagmm_o3d.result import PointRegistrationResult

HIDDEN, CONTRADICTED, PARTNER = 0, 1, 2
MILLIMETRES_PER_METRE = 1000.0


@dataclass(frozen=True)
class PointsAtPose:
    """Where the M source points are at a pose, seen from the target.

    overlap : (M,) PARTNER, HIDDEN or CONTRADICTED, as in PointDiagnostics.    nearest : (M,) the nearest target point.
    moved : (M, 3) [m], in the target's frame.    distances : (M,) [m] to the nearest target point.
    """

    overlap: np.ndarray
    nearest: np.ndarray
    moved: np.ndarray
    distances: np.ndarray


@dataclass(frozen=True)
class PointDiagnostics:
    """What is known of each source point at the estimated pose; M points.

    weight_share : (M,) its share of the pair weights, times M: 1 is average, 0 is ignored.
    residual_mm : (M,) distance to the target's surface, along its normal where it has them; NaN without partner.
    overlap : (M,) PARTNER: the target has a point within `partner_distance`. HIDDEN: outside the target's image, or
        behind what it sees. CONTRADICTED: in front of what the target sees, which looks through it.
    partner : (M,) the index of the nearest target point, -1 without partner.    partner_distance : [m].
    color_support : (M,) how much the colours speak for the point's partners [nats], NaN without; None where they did
        not count.
    """

    weight_share: np.ndarray
    residual_mm: np.ndarray
    overlap: np.ndarray
    partner: np.ndarray
    partner_distance: float
    color_support: np.ndarray | None = None


def diagnose(
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    estimate: PointRegistrationResult,
    *,
    target_frame: RGBDFrame | None = None,
    partner_distance: float | None = None,
) -> PointDiagnostics:
    """Look at every source point at the estimate's pose.

    Parameters
    ----------
    source, target : what was registered, points [m].
    estimate : with transformation (4, 4) and row_weights (M,), as `PointRegistrationResult` has them.
    target_frame : the target's depth image, to tell points it cannot see from points that contradict it; without it
        every point without partner counts as HIDDEN.
    partner_distance : [m]; None for the one that registrations are judged by.
    """
    near = partners.partner_distance(target, partner_distance)
    found = points_at_pose(source, target, estimate.transformation, near, target_frame)
    residuals = found.distances
    if target.has_normals():
        gap = found.moved - np.asarray(target.points)[found.nearest]
        residuals = np.abs(np.einsum("ij,ij->i", gap, np.asarray(target.normals)[found.nearest]))
    has_partner = found.overlap == PARTNER
    return PointDiagnostics(
        weight_share=weight_shares(estimate.row_weights),
        residual_mm=np.where(has_partner, residuals * MILLIMETRES_PER_METRE, np.nan),
        overlap=found.overlap,
        partner=np.where(has_partner, found.nearest, -1),
        partner_distance=near,
        color_support=estimate.color_support,
    )


def points_at_pose(
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    T_target_source: np.ndarray,
    partner_distance: float,
    target_frame: RGBDFrame | None = None,
) -> PointsAtPose:
    """Whom every source point meets at a pose (4, 4); arguments as in `diagnose`."""
    T = np.asarray(T_target_source)
    moved = np.asarray(source.points) @ T[:3, :3].T + T[:3, 3]
    distances, nearest = cKDTree(np.asarray(target.points)).query(moved)
    has_partner = distances <= partner_distance
    overlap = np.where(has_partner, PARTNER, HIDDEN)
    if target_frame is not None:
        overlap[~has_partner & _contradicted(moved, target_frame, partner_distance)] = CONTRADICTED
    return PointsAtPose(overlap, nearest, moved, distances)


def weight_shares(row_weights: np.ndarray) -> np.ndarray:
    """(M,) weights as shares of their sum, times M; 0 where a point was dropped (NaN)."""
    weights = np.nan_to_num(np.asarray(row_weights, dtype=np.float64))
    return weights * len(weights) / max(weights.sum(), np.finfo(np.float64).tiny)


def _contradicted(points: np.ndarray, frame: RGBDFrame, margin: float) -> np.ndarray:
    """(M,) whether the target camera measured something clearly behind the point: it looked through it."""
    camera, depth = frame.intrinsics, frame.depth_m()
    z = points[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.floor(camera.fx * points[:, 0] / z + camera.cx + 0.5)
        v = np.floor(camera.fy * points[:, 1] / z + camera.cy + 0.5)
    inside = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    measured = np.full(len(points), np.nan)
    measured[inside] = depth[v[inside].astype(int), u[inside].astype(int)]
    return inside & (measured > z + margin)
