"""Point clouds as Rerun archetypes, each in its own sensor's frame."""

import numpy as np
import open3d as o3d
import rerun as rr

from adagmm_fusion.rerun_log.when import When
from adagmm_o3d.errors import InputError

DEFAULT_COLOR = (180, 180, 180)
RADIUS_SHARE_OF_SPACING = 0.45


def point_radius(points: np.ndarray) -> float:
    """A radius [m] at which neighbouring points just touch; 5 mm for fewer than two points."""
    if len(points) < 2:
        return 0.005
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    return RADIUS_SHARE_OF_SPACING * float(np.median(cloud.compute_nearest_neighbor_distance()))


def as_uint8(colors: np.ndarray) -> np.ndarray:
    """(N, 3) Open3D colours in 0..1 as (N, 3) uint8."""
    return np.floor(np.clip(colors, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def log_points(rec, entity: str, points: np.ndarray, colors, when: When, *, radius: float | None = None) -> None:
    """Log points (N, 3) [m] with colours: (N, 3) or (N, 4) uint8, or one colour for all.

    Raises
    ------
    InputError  if there are neither one nor N colours; Rerun itself would show the last one on the rest.
    """
    colors = np.atleast_2d(np.asarray(colors, dtype=np.uint8))
    if len(colors) not in (1, len(points)):
        raise InputError(f"{entity}: expected 1 or {len(points)} colors to match the points, got {len(colors)}")
    radius = point_radius(points) if radius is None else radius
    when.log(rec, entity, rr.Points3D(np.asarray(points, dtype=np.float32), colors=colors, radii=np.float32(radius)))


def log_cloud(rec, entity: str, cloud: o3d.geometry.PointCloud, when: When, *, radius: float | None = None) -> None:
    """Log an Open3D cloud with its own colours, or grey where it has none."""
    colors = as_uint8(np.asarray(cloud.colors)) if cloud.has_colors() else DEFAULT_COLOR
    log_points(rec, entity, np.asarray(cloud.points), colors, when, radius=radius)
