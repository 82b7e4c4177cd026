"""A depth image as a textured surface: a coarse grid of triangles, open at depth edges."""

import numpy as np

from adagmm_fusion.frames.depth_geometry import depth_edges, depth_in_range, depth_jumps, pixel_rays
from adagmm_fusion.frames.rgbd import RGBDFrame
from adagmm_o3d.errors import InputError

# Triangles seen at a more grazing angle than this are more likely a gap between two surfaces.
GRAZING_ANGLE_DEG = 80.0


def textured_grid(
    frame: RGBDFrame, *, step: int = 4, min_depth: float = 0.1, max_depth: float = 6.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles over the image's blocks of step x step pixels, each vertex at its block's median depth.

    Parameters
    ----------
    step : pixels between vertices.
    min_depth, max_depth : [m], what lies outside is left out.

    Returns
    -------
    vertices : (N, 3) float64 [m], camera frame.
    triangles : (K, 3) int32, counter-clockwise seen from the camera; none across a depth edge.
    uvs : (N, 2) float32 in 0..1 from the colour image's top left corner, u right, v down.

    Raises
    ------
    InputError  if step is not positive or larger than the image, or there is no triangle.
    """
    height, width = frame.depth.shape
    if isinstance(step, bool) or not isinstance(step, int) or not 1 <= step <= min(height, width) // 2:
        raise InputError(f"step: expected 1 to {min(height, width) // 2} pixels, got {step!r}")
    depth = depth_in_range(frame, min_depth, max_depth)
    depth[depth_edges(depth, frame.intrinsics)] = np.nan
    z = _block_medians(depth, step)
    triangles = _grid_triangles(z, frame, step)
    if not len(triangles):
        raise InputError(f"{frame.name}: {frame.sensor}: no surface between {min_depth:g} and {max_depth:g} m")
    rays = _blocks(pixel_rays(frame.intrinsics), step).mean(axis=2)
    points = np.concatenate((rays * z[..., None], z[..., None]), axis=-1).reshape(-1, 3)
    v, u = (np.indices(z.shape) + 0.5) * step  # block centres
    uvs = np.stack((u / width, v / height), axis=-1).reshape(-1, 2)
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used], triangles.reshape(-1, 3).astype(np.int32), uvs[used].astype(np.float32)


def _blocks(values: np.ndarray, step: int) -> np.ndarray:
    """(rows, columns, step * step, ...): the pixels of each whole block."""
    rows, columns = values.shape[0] // step, values.shape[1] // step
    cut = values[: rows * step, : columns * step].reshape(rows, step, columns, step, *values.shape[2:])
    return cut.swapaxes(1, 2).reshape(rows, columns, step * step, *values.shape[2:])


def _block_medians(depth: np.ndarray, step: int) -> np.ndarray:
    """(rows, columns) float64, NaN where a block has no depth. The lower median: a depth that was measured."""
    blocks = np.sort(_blocks(depth, step), axis=-1)  # NaN sorts last
    count = np.isfinite(blocks).sum(axis=-1)
    middle = np.maximum(count - 1, 0) // 2
    return np.take_along_axis(blocks, middle[..., None], axis=-1)[..., 0].astype(np.float64)


def _grid_triangles(z: np.ndarray, frame: RGBDFrame, step: int) -> np.ndarray:
    """(K, 3) indices into the flattened grid: two triangles in each square, where it lies on one surface."""
    index = np.arange(z.size).reshape(z.shape)
    first, last = slice(None, -1), slice(1, None)
    a, b, c, d = (first, first), (first, last), (last, first), (last, last)  # the square's corners, row by row
    focal_length = min(frame.intrinsics.fx, frame.intrinsics.fy) / step

    def joined(p, q, pixels=1.0):
        jump = depth_jumps(z[p], z[q], focal_length / pixels, GRAZING_ANGLE_DEG)
        return np.isfinite(z[p]) & np.isfinite(z[q]) & ~jump

    diagonal = joined(b, c, np.sqrt(2.0))
    upper = joined(a, b) & joined(a, c) & diagonal
    lower = joined(b, d) & joined(c, d) & diagonal
    upper = np.stack((index[a][upper], index[c][upper], index[b][upper]), axis=-1)
    lower = np.stack((index[b][lower], index[c][lower], index[d][lower]), axis=-1)
    return np.concatenate((upper, lower))
