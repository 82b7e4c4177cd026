"""Depth seen by one camera moved onto the pixel grid of another, as sensors do that register depth to colour."""

import cv2
import numpy as np

from adagmm_fusion.frames.depth_geometry import back_project, pixel_rays
from adagmm_fusion.frames.rgbd import PinholeIntrinsics

# What is farther off the axis than the image's corners, by a little, is beyond what the lens model holds for.
WITHIN_LENS = 1.05


def register_depth(
    depth: np.ndarray,
    depth_intrinsics: PinholeIntrinsics,
    color_intrinsics: PinholeIntrinsics,
    T_color_depth: np.ndarray,
    depth_scale: float,
) -> np.ndarray:
    """The depth image as the colour camera would see it.

    Each depth pixel becomes a point, and the nearest of the points that fall into a colour pixel is its depth. Where
    the colour image is finer, a point covers the pixels that its depth pixel covers there, so that no gaps open
    between them.

    Parameters
    ----------
    depth : (H, W) uint16 or float, depth units, 0 for none.
    depth_intrinsics, color_intrinsics : of the two cameras; lens distortion counts for both.
    T_color_depth : (4, 4) [m], depth camera frame to colour camera frame.
    depth_scale : depth units per metre.

    Returns
    -------
    (color height, color width) float32, depth units, 0 for none.
    """
    with np.errstate(invalid="ignore"):
        metres = np.where(depth > 0, depth / depth_scale, np.nan)
    points = back_project(metres, depth_intrinsics)
    points = points[np.isfinite(points[..., 2])] @ T_color_depth[:3, :3].T + T_color_depth[:3, 3]
    points = points[points[:, 2] > 0]
    points = points[np.argsort(-points[:, 2], kind="stable")]  # nearer points are written later, over farther ones
    x, y, z = points.T
    u, v = _projected(x / z, y / z, color_intrinsics)
    reach_u = 0.5 * max(color_intrinsics.fx / depth_intrinsics.fx, 1.0)
    reach_v = 0.5 * max(color_intrinsics.fy / depth_intrinsics.fy, 1.0)
    registered = np.zeros((color_intrinsics.height, color_intrinsics.width), dtype=np.float32)
    first_u, first_v = np.ceil(u - reach_u).astype(int), np.ceil(v - reach_v).astype(int)
    order = np.arange(len(z))
    latest = np.full(registered.shape, -1)
    for right in range(int(np.ceil(2 * reach_u))):
        for down in range(int(np.ceil(2 * reach_v))):
            column, row = first_u + right, first_v + down
            seen = (column < u + reach_u) & (row < v + reach_v) & (column >= 0) & (row >= 0)
            seen &= (column < color_intrinsics.width) & (row < color_intrinsics.height)
            np.maximum.at(latest, (row[seen], column[seen]), order[seen])
    registered[latest >= 0] = (z * depth_scale)[latest[latest >= 0]]
    return registered


def _projected(x: np.ndarray, y: np.ndarray, k: PinholeIntrinsics) -> tuple[np.ndarray, np.ndarray]:
    """(N,) columns and rows of what is seen at x/z, y/z; far outside where the lens would fold it into the image."""
    if not k.distorted:
        return k.fx * x + k.cx, k.fy * y + k.cy
    rays = np.column_stack((x, y, np.ones(len(x))))
    beyond = np.hypot(x, y) > WITHIN_LENS * np.hypot(*np.moveaxis(pixel_rays(k), -1, 0)).max()
    rays[beyond] = (0.0, 0.0, 1.0)
    if not len(rays):
        return x, y
    pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), k.matrix(), np.array(k.distortion))
    pixels = pixels.reshape(-1, 2)
    pixels[beyond] = -1e6
    return pixels[:, 0], pixels[:, 1]
