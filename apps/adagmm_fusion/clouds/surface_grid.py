"""A frame's measured surface on the image's own grid: what clouds are thinned from and poses are refined on."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from adagmm_fusion.frames.depth_geometry import back_project, depth_edges, depth_in_range, depth_noise, grid_normals
from adagmm_fusion.frames.rgbd import RGBDFrame

# No room has as large a share of its pixels at edges.
MOSTLY_EDGES = 0.5


@dataclass(frozen=True, eq=False)
class SurfaceGrid:
    """points (H, W, 3) [m, camera frame], unit normals (H, W, 3) towards the camera, and (H, W) where there are both.

    Pixels at depth edges are not: sensors report points in mid-air there.
    """

    points: np.ndarray
    normals: np.ndarray
    known: np.ndarray


@lru_cache(maxsize=2)  # a pair's two frames, whose clouds are made before their pose is refined
def surface_grid(frame: RGBDFrame, min_depth: float, max_depth: float) -> SurfaceGrid:
    """The surface between two depths [m]."""
    depth = depth_in_range(frame, min_depth, max_depth)
    edges = depth_edges(depth, frame.intrinsics)
    if edges.sum() > MOSTLY_EDGES * np.isfinite(depth).sum():  # a noisy sensor: its noise looks like edges
        edges = depth_edges(depth, frame.intrinsics, depth_noise(depth))
    depth[edges] = np.nan
    normals = grid_normals(depth, frame.intrinsics)
    return SurfaceGrid(back_project(depth, frame.intrinsics), normals, np.isfinite(normals[..., 0]))
