"""Colour and depth images of different sizes, or of two cameras, brought onto one pixel grid."""

import cv2
import numpy as np

from adagmm_fusion.frames.depth_registration import register_depth
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_o3d.errors import InputError

# Depth is drawn out over at most so many pixels each way; a finer colour image is made smaller.
MAX_ENLARGEMENT = 3.0
# Depths around a pixel are mixed where they differ less than this share, as on one surface.
ONE_SURFACE = 0.05
SAME_SHAPE = 0.01


def scaled_intrinsics(k: PinholeIntrinsics, size: tuple[int, int]) -> PinholeIntrinsics:
    """The intrinsics of the same view in an image of `size` (width, height).

    Raises
    ------
    InputError  if the two sizes are not of one shape: an image is cropped, or of another camera.
    """
    x, y = size[0] / k.width, size[1] / k.height
    if abs(x - y) > SAME_SHAPE * x:
        raise InputError(f"the intrinsics are for {k.width}x{k.height} pixels, which is no scaled {size[0]}x{size[1]}")
    return PinholeIntrinsics(
        *size, x * k.fx, y * k.fy, x * (k.cx + 0.5) - 0.5, y * (k.cy + 0.5) - 0.5, distortion=k.distortion
    )


def on_one_grid(
    color: np.ndarray,
    depth: np.ndarray,
    color_intrinsics: PinholeIntrinsics,
    depth_scale: float,
    depth_intrinsics: PinholeIntrinsics | None = None,
    T_color_depth: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, PinholeIntrinsics]:
    """Colour, depth and intrinsics of the grid that they then share.

    With the depth camera's own calibration the depth is registered to the colour image. Without it both are taken for
    the view of one camera, and the coarser one is made finer; a colour image that is much finer is made smaller.

    Parameters
    ----------
    color : (H, W, 3) uint8.    depth : (h, w), depth units, 0 or not finite for none.
    color_intrinsics, depth_intrinsics : of the images, or of the same views in another size.
    depth_scale : depth units per metre.    T_color_depth : (4, 4) [m]; None if the two cameras are at one place.

    Raises
    ------
    InputError  if the sizes do not go together.
    """
    color_size, depth_size = color.shape[1::-1], depth.shape[::-1]
    k = scaled_intrinsics(color_intrinsics, color_size)
    if depth_intrinsics is not None:
        of_depth = scaled_intrinsics(depth_intrinsics, depth_size)
        if of_depth != k or not (T_color_depth is None or np.array_equal(T_color_depth, np.eye(4))):
            T = np.eye(4) if T_color_depth is None else T_color_depth
            depth = register_depth(depth, of_depth, k, T, depth_scale)
        return color, depth, k
    if color_size == depth_size:
        return color, depth, k
    wide, high = (c / d for c, d in zip(color_size, depth_size, strict=True))
    if abs(wide - high) > SAME_SHAPE * wide:
        raise InputError(
            f"color is {color_size[0]}x{color_size[1]} and depth {depth_size[0]}x{depth_size[1]}, which is no "
            "scaled view of one camera; give both cameras' calibrations, or register the depth to the colour"
        )
    shrink = max(int(np.ceil(wide / MAX_ENLARGEMENT)), 1)
    size = (color_size[0] // shrink, color_size[1] // shrink) if wide > 1 else depth_size
    how = cv2.INTER_AREA if size[0] < color_size[0] else cv2.INTER_LINEAR
    return cv2.resize(color, size, interpolation=how), _resized_depth(depth, size), scaled_intrinsics(k, size)


def _resized_depth(depth: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(height, width) float32: mixed within a surface, else the nearest pixel's; 0 where that has none."""
    height, width = depth.shape
    if size == (width, height):
        return depth
    with np.errstate(invalid="ignore"):
        stored = np.where(np.isfinite(depth) & (depth > 0), depth, 0.0).astype(np.float64)
    u = np.clip((np.arange(size[0]) + 0.5) * width / size[0] - 0.5, 0.0, width - 1.0)
    v = np.clip((np.arange(size[1]) + 0.5) * height / size[1] - 0.5, 0.0, height - 1.0)
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    corners = np.stack([stored[np.ix_(rows, columns)] for rows in (top, bottom) for columns in (left, right)])
    a, b = (u - left)[None, :], (v - top)[:, None]
    weights = np.stack(np.broadcast_arrays((1 - b) * (1 - a), (1 - b) * a, b * (1 - a), b * a))
    lowest, highest = corners.min(axis=0), corners.max(axis=0)
    one_surface = (lowest > 0) & (highest - lowest <= ONE_SURFACE * lowest)
    nearest = np.take_along_axis(corners, weights.argmax(axis=0)[None], axis=0)[0]
    return np.where(one_surface, (weights * corners).sum(axis=0), nearest).astype(np.float32)
