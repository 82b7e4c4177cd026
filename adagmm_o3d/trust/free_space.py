"""What a sensor has seen to be empty: nothing can stand in front of the surface that it measured.

Where it is known from where a cloud was seen, each of its points says that the way there is free. Two poses may match
the same share of the surfaces; the one that puts points of one cloud before what the other's sensor saw is wrong.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array

# Edge of a pixel of the range image, in mean distances between neighbouring directions.
PIXEL = 2.0
# The largest range image, in pixels.
LARGEST = 1 << 20
# A point violates free space when it lies this far in front of the surface: in radii, and as a share of its range.
TOLERANCE, TOLERANCE_SHARE = 0.025, 0.02


class RangeImage:
    """How far a sensor saw in each direction: (n, 3) points of a cloud and the (3,) viewpoint, in the same frame."""

    def __init__(self, points: Array, viewpoint: Array) -> None:
        self._viewpoint = viewpoint
        directions, ranges = self._polar(points)
        middle = directions.mean(axis=0)
        # Angles are measured about the mean direction, where a pinhole camera's have no poles in view.
        forward = middle / np.linalg.norm(middle) if np.linalg.norm(middle) > 1e-3 else np.array([0.0, 0.0, 1.0])
        side = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
        side /= np.linalg.norm(side)
        self._axes = np.stack([side, np.cross(forward, side), forward])
        angles = self._angles(directions)
        extent = np.ptp(angles, axis=0)
        area = max(float(extent.prod()), 1e-12)
        self._pixel = PIXEL * math.sqrt(area / len(points))
        self._pixel = max(self._pixel, math.sqrt(area / LARGEST), float(extent.max()) / math.sqrt(LARGEST))
        self._corner = angles.min(axis=0) - 1.5 * self._pixel
        shape = tuple((extent / self._pixel).astype(int) + 4)
        nearest = np.full(shape, np.inf)
        pixels = self._pixels(angles)
        np.minimum.at(nearest, (pixels[:, 0], pixels[:, 1]), ranges)
        # An edge lies anywhere within a pixel: the least of the pixels around counts.
        padded = np.pad(nearest, 1, constant_values=np.inf)
        around = [padded[i : i + shape[0], j : j + shape[1]] for i in range(3) for j in range(3)]
        self._free = np.where(np.isfinite(nearest), np.min(around, axis=0), 0.0)

    def violations(self, points: Array) -> float:
        """Share of (k, 3) points that lie in front of what the sensor saw behind them."""
        directions, ranges = self._polar(points)
        pixels = self._pixels(self._angles(directions))
        inside = ((pixels >= 0) & (pixels < self._free.shape)).all(axis=1)
        free = self._free[pixels[inside, 0], pixels[inside, 1]]
        ranges = ranges[inside]
        return float((ranges * (1.0 + TOLERANCE_SHARE) + TOLERANCE < free).sum()) / len(points)

    def _polar(self, points: Array) -> tuple[Array, Array]:
        offsets = points - self._viewpoint
        ranges = np.sqrt((offsets**2).sum(axis=1))
        return offsets / np.maximum(ranges, 1e-12)[:, None], ranges

    def _angles(self, directions: Array) -> Array:
        x, y, z = self._axes @ directions.T
        return np.stack([np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))], axis=1)

    def _pixels(self, angles: Array) -> NDArray[np.int64]:
        return np.floor((angles - self._corner) / self._pixel).astype(np.int64)
