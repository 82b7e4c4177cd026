"""Point clouds as Rerun archetypes, each in its own sensor's frame.

The positions are logged once. What a view wants to say with colours is a layer: another set of colours on the same
entity, which the blueprint maps onto the points of that view.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import open3d as o3d
import rerun as rr
from scipy.spatial import cKDTree

from adagmm_fusion.rerun_log.when import When
from adagmm_o3d.errors import InputError

DEFAULT_COLOR = (180, 180, 180)
RADIUS_SHARE_OF_SPACING = 0.6
SPACING_SAMPLE = 2000
LIGHT = np.array((-0.4, -0.7, -0.6)) / np.linalg.norm((-0.4, -0.7, -0.6))
AMBIENT = 0.35

SHAPE = "Shape"
WEIGHT_SHARE = "WeightShare"
RESIDUAL_MM = "ResidualMm"
OVERLAP = "Overlap"
COLOR_SUPPORT = "ColorSupport"
DIMMED = "Dimmed"


def point_radius(points: np.ndarray) -> float:
    """A radius [m] at which neighbouring points close the surface; 5 mm for fewer than two points."""
    if len(points) < 2:
        return 0.005
    sample = points[:: max(1, len(points) // SPACING_SAMPLE)]
    distances, _ = cKDTree(points).query(sample, k=2)
    return RADIUS_SHARE_OF_SPACING * float(np.median(distances[:, 1]))


def own_colors(cloud: o3d.geometry.PointCloud) -> np.ndarray:
    """(N, 3) uint8, grey where the cloud has no colours."""
    if not cloud.has_colors():
        return np.tile(np.asarray(DEFAULT_COLOR, np.uint8), (len(cloud.points), 1))
    return np.floor(np.clip(np.asarray(cloud.colors), 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def shaded_colors(cloud: o3d.geometry.PointCloud, color: tuple[int, int, int]) -> np.ndarray:
    """(N, 3) uint8: one colour for the whole cloud, lit from above to show its shape; flat without normals."""
    if not cloud.has_normals():
        return np.tile(np.asarray(color, np.uint8), (len(cloud.points), 1))
    return lit_colors(np.asarray(cloud.normals), color)


def lit_colors(normals: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """(N, 3) uint8: a colour as it looks on surfaces with these unit normals (N, 3), of either sign."""
    lit = AMBIENT + (1.0 - AMBIENT) * np.abs(normals @ LIGHT)
    return np.clip(lit[:, None] * np.asarray(color, dtype=np.float64), 0, 255).astype(np.uint8)


def log_points(
    rec: rr.RecordingStream,
    entity: str,
    points: np.ndarray,
    colors: np.ndarray,
    when: When,
    layers: Mapping[str, np.ndarray] | None = None,
    values: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Log points (N, 3) [m] with colours (N, 3) uint8, and further sets of colours by the name of their layer.

    values : numbers (N,) by name, which the viewer tells of a point that is selected.

    Raises
    ------
    InputError  if there are not N colours or numbers; Rerun itself would go on with the last one.
    """
    positions = np.ascontiguousarray(points, dtype=np.float32)
    archetypes: list[Any] = [
        rr.Points3D(positions, colors=_checked(entity, colors, len(positions)), radii=point_radius(points))
    ]
    for layer, layer_colors in (layers or {}).items():
        batch = rr.components.ColorBatch(_checked(f"{entity}:{layer}", layer_colors, len(positions)))
        # Without its type the viewer would tell a colour as a number.
        named = rr.ComponentDescriptor(f"{layer}:colors", archetype=layer, component_type="rerun.components.Color")
        archetypes.append([batch.described(named)])
    for name, numbers in (values or {}).items():
        if np.shape(numbers) != (len(positions),):
            raise InputError(
                f"{entity}:{name}: expected ({len(positions)},) to match the points, got {np.shape(numbers)}"
            )
    if values:
        archetypes.append(rr.AnyValues(**values))
    when.log(rec, entity, *archetypes)


def variance_mm2(cloud: o3d.geometry.PointCloud, sigma: float) -> np.ndarray | None:
    """(N,) mean variance of each point at the scale σ [mm²], a third of the trace of σ·Σ; None without covariances."""
    if not cloud.has_covariances():
        return None
    return 1e6 * sigma * np.trace(np.asarray(cloud.covariances), axis1=1, axis2=2) / 3.0


def _checked(name: str, colors: np.ndarray, n: int) -> np.ndarray:
    colors = np.asarray(colors)
    if colors.dtype != np.uint8 or colors.shape != (n, 3):
        raise InputError(
            f"{name}: expected ({n}, 3) uint8 colors to match the points, got {colors.shape} {colors.dtype}"
        )
    return colors
