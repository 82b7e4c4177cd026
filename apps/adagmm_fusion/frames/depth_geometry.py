"""Geometry on the depth image's own grid: rays, points, depth edges and normals."""

from functools import lru_cache

import cv2
import numpy as np

from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_o3d.errors import InputError

# Two neighbouring pixels count as one surface if the camera would see that surface at this angle or squarer.
EDGE_ANGLE_DEG = 86.0
# Of Gaussian differences one in a hundred is larger than this many standard deviations.
NOISE_DEVIATIONS = 2.6


@lru_cache(maxsize=8)
def pixel_rays(intrinsics: PinholeIntrinsics) -> np.ndarray:
    """(H, W, 2) float64: x/z and y/z of what each pixel sees, lens distortion undone. Read-only, kept for later."""
    v, u = np.indices((intrinsics.height, intrinsics.width), dtype=np.float64)
    rays = np.stack(((u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy), axis=-1)
    if intrinsics.distorted:
        rays = _undistort(np.stack((u, v), axis=-1).reshape(-1, 2), intrinsics).reshape(rays.shape)
    rays.flags.writeable = False
    return rays


def _undistort(pixels: np.ndarray, intrinsics: PinholeIntrinsics) -> np.ndarray:
    """(N, 2) rays of (N, 2) pixels, by projecting and correcting until no pixel is off by more than a millionth."""
    K, distortion = intrinsics.matrix(), np.array(intrinsics.distortion)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), K, distortion).reshape(-1, 2)
    left = np.arange(len(pixels))
    for _ in range(100):
        homogeneous = np.column_stack((rays[left], np.ones(len(left))))
        seen, _ = cv2.projectPoints(homogeneous, np.zeros(3), np.zeros(3), K, distortion)
        miss = seen.reshape(-1, 2) - pixels[left]
        off = ~(np.abs(miss).max(axis=1) < 1e-6)
        left, miss = left[off], miss[off]
        if not left.size:
            return rays
        rays[left] -= miss / (intrinsics.fx, intrinsics.fy)
    raise InputError(
        f"intrinsics.distortion: cannot be undone for {intrinsics.width}x{intrinsics.height} pixels, the model folds "
        "over inside the image; recalibrate with fewer coefficients"
    )


def project(points: np.ndarray, intrinsics: PinholeIntrinsics) -> np.ndarray:
    """(2, N) float64 columns and rows of points (N, 3) [m, camera frame] in the image; NaN where it cannot see them.

    Lens models fold over far outside the image, so what the undistorted rays of its pixels do not reach is not seen.
    """
    found = np.full((2, len(points)), np.nan)
    ahead = points[:, 2] > 0.0
    rays = points[ahead, :2] / points[ahead, 2:]
    pixels = rays * (intrinsics.fx, intrinsics.fy) + (intrinsics.cx, intrinsics.cy)
    if intrinsics.distorted:
        grid = pixel_rays(intrinsics).reshape(-1, 2)
        low, high = grid.min(axis=0), grid.max(axis=0)
        margin = 0.05 * (high - low)
        inside = ((rays >= low - margin) & (rays <= high + margin)).all(axis=1)
        pixels[~inside] = np.nan
        if inside.any():
            K, distortion = intrinsics.matrix(), np.array(intrinsics.distortion)
            ones = np.column_stack((rays[inside], np.ones(np.count_nonzero(inside))))
            pixels[inside] = cv2.projectPoints(ones, np.zeros(3), np.zeros(3), K, distortion)[0].reshape(-1, 2)
    found[:, ahead] = pixels.T
    return found


def back_project(depth_m: np.ndarray, intrinsics: PinholeIntrinsics) -> np.ndarray:
    """(H, W, 3) float64 [m], camera frame; NaN where there is no depth."""
    z = depth_m.astype(np.float64)
    rays = pixel_rays(intrinsics)
    return np.stack((rays[..., 0] * z, rays[..., 1] * z, z), axis=-1)


def depth_in_range(frame: RGBDFrame, min_depth: float, max_depth: float) -> np.ndarray:
    """(H, W) float32 [m], NaN where there is no depth between the limits."""
    depth = frame.depth_m()
    with np.errstate(invalid="ignore"):
        depth[~((depth >= min_depth) & (depth <= max_depth))] = np.nan
    return depth


def depth_edges(depth_m: np.ndarray, intrinsics: PinholeIntrinsics, noise: np.ndarray | None = None) -> np.ndarray:
    """(H, W) bool: pixels with a depth jump to one of their four neighbours, where sensors report points in mid-air.

    `noise` (H, W) is the depth's standard deviation [m] of each pixel; where it is given, a jump is also larger than it
    would make one of a hundred.
    """
    edges = np.zeros(depth_m.shape, dtype=bool)
    down = np.s_[:-1, :], np.s_[1:, :], intrinsics.fy
    right = np.s_[:, :-1], np.s_[:, 1:], intrinsics.fx
    for here, there, focal_length in (down, right):
        a, b = depth_m[here], depth_m[there]
        jump = depth_jumps(a, b, focal_length, EDGE_ANGLE_DEG)
        if noise is not None:
            with np.errstate(invalid="ignore"):
                jump &= np.abs(a - b) > NOISE_DEVIATIONS * np.hypot(noise[here], noise[there])
        edges[here] |= jump
        edges[there] |= jump
    return edges


def depth_noise(depth_m: np.ndarray) -> np.ndarray:
    """(H, W) [m]: standard deviation of noise that is independent from pixel to pixel and grows with depth squared.

    By the median second difference along rows, which surfaces, flat or bent, do not have. NaN where no depth is.
    """
    with np.errstate(invalid="ignore"):
        second = np.abs(depth_m[:, 2:] - 2.0 * depth_m[:, 1:-1] + depth_m[:, :-2]) / depth_m[:, 1:-1] ** 2
    second = second[np.isfinite(second)]
    # A Gaussian's median magnitude is 0.6745 of its deviation; the weights 1, -2, 1 make that sqrt(6) times as large.
    factor = float(np.median(second)) / (0.6745 * np.sqrt(6.0)) if second.size else 0.0
    return factor * depth_m**2


def depth_jumps(a: np.ndarray, b: np.ndarray, focal_length: float, angle_deg: float) -> np.ndarray:
    """Whether depths of pixels side by side differ more than on a surface seen at `angle_deg`; no where one is NaN."""
    steepest = np.tan(np.radians(angle_deg)) / focal_length
    with np.errstate(invalid="ignore"):
        return np.abs(a - b) > steepest * np.minimum(a, b)


def grid_normals(depth_m: np.ndarray, intrinsics: PinholeIntrinsics, *, window: int = 9) -> np.ndarray:
    """Unit normals towards the camera, from planes fitted to the window of pixels around each pixel.

    On a plane n . p = d the inverse depth is linear in the ray, 1/z = (n/d) . (x/z, y/z, 1), so the fit is a linear
    one made of box sums, and its residual is in the unit in which structured light is equally good everywhere. Of the
    windows centred on the pixel and half a window off to each corner, the one that fits best is taken, so normals stay
    sharp at creases.

    Returns
    -------
    (H, W, 3) float64; NaN where there is no depth or fewer than half of a window has.
    """
    valid = np.isfinite(depth_m)
    w = valid.astype(np.float64)
    inverse = w / np.where(valid, depth_m, 1.0)
    rays = pixel_rays(intrinsics)
    x, y = rays[..., 0], rays[..., 1]

    def window_sum(values):
        return cv2.boxFilter(values, cv2.CV_64F, (window, window), normalize=False, borderType=cv2.BORDER_CONSTANT)

    count = window_sum(w)

    def mean(values):
        return window_sum(values) / np.maximum(count, 1.0)

    mx, my, mi = mean(w * x), mean(w * y), mean(inverse)
    xx, xy, yy = mean(w * x * x) - mx * mx, mean(w * x * y) - mx * my, mean(w * y * y) - my * my
    xi, yi, ii = mean(x * inverse) - mx * mi, mean(y * inverse) - my * mi, mean(inverse * inverse) - mi * mi
    determinant = xx * yy - xy * xy
    usable = (count >= 0.5 * window * window) & (determinant > 1e-6 * (xx + yy) ** 2)
    determinant = np.where(usable, determinant, 1.0)
    gx, gy = (yy * xi - xy * yi) / determinant, (xx * yi - xy * xi) / determinant
    residual = np.where(usable, np.maximum(ii - gx * xi - gy * yi, 0.0), np.inf)
    planes = np.stack((gx, gy, mi - gx * mx - gy * my), axis=-1)

    rows, columns = _best_window(residual, window // 2)
    planes = planes[rows, columns]
    length = np.linalg.norm(planes, axis=-1)
    usable = valid & np.isfinite(residual[rows, columns]) & (length > 0)
    away = np.sign(planes[..., 0] * x + planes[..., 1] * y + planes[..., 2])
    scale = np.where(usable, -away / np.where(usable, length, 1.0), np.nan)
    return planes * scale[..., None]


def _best_window(residual: np.ndarray, half: int) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the window centre to use for each pixel; a corner's only where it is clearly better."""
    height, width = residual.shape
    rows, columns = (np.asarray(index) for index in np.indices(residual.shape))
    best, best_rows, best_columns = 0.5 * residual, rows, columns
    for down in (-half, half):
        for right in (-half, half):
            r, c = np.clip(rows + down, 0, height - 1), np.clip(columns + right, 0, width - 1)
            better = residual[r, c] < best
            best = np.where(better, residual[r, c], best)
            best_rows, best_columns = np.where(better, r, best_rows), np.where(better, c, best_columns)
    return best_rows, best_columns
