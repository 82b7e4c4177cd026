"""Points sorted so that neighbours lie together, and cut into tiles; the culling looks at the tiles' bounding boxes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.culling import GROUP, TILE

Float32 = NDArray[np.float32]

# Entry n has the ten bits of n with two zeros between them: three such numbers, shifted, make a Morton code.
SPREAD_BITS = np.array([sum((n >> bit & 1) << 3 * bit for bit in range(10)) for n in range(1024)], np.uint32)


class Corners(NamedTuple):
    """Bounding boxes by their corners, (3, count): of each tile of TILE points, and of each group of GROUP tiles."""

    lo: Float32
    hi: Float32
    group_lo: Float32
    group_hi: Float32


class Tiles(NamedTuple):
    """The boxes of tiles and of groups, with the largest variance and bits of the points in each, (count,)."""

    lo: Float32
    hi: Float32
    variance: Float32
    bits: Float32
    group_lo: Float32
    group_hi: Float32
    group_variance: Float32
    group_bits: Float32

    def at(self, sigma: np.float32) -> Tiles:
        """The same with every variance times σ."""
        return self._replace(variance=self.variance * sigma, group_variance=self.group_variance * sigma)


def make_tiles(points: Float32, variances: Float32, bits: Float32) -> Tiles:
    """The tiles of (3, n) ordered points, given the variances and bits of each, (n,); see `culling.reach_sq`."""
    boxes = find_corners(points)
    (variance, most), (group_variance, group_most) = maxima(np.stack([variances, bits]))
    return Tiles(boxes.lo, boxes.hi, variance, most, boxes.group_lo, boxes.group_hi, group_variance, group_most)


def find_corners(points: Float32) -> Corners:
    """The boxes that (3, n) ordered points lie in."""
    lo, hi = _reduce(np.minimum, points, TILE), _reduce(np.maximum, points, TILE)
    return Corners(lo, hi, _reduce(np.minimum, lo, GROUP), _reduce(np.maximum, hi, GROUP))


def maxima(values: Float32) -> tuple[Float32, Float32]:
    """The largest of (k, n) values in each tile and in each group."""
    of_tiles = _reduce(np.maximum, values, TILE)
    return of_tiles, _reduce(np.maximum, of_tiles, GROUP)


def _reduce(ufunc: np.ufunc, values: Float32, size: int) -> Float32:
    return np.ascontiguousarray(ufunc.reduceat(values, np.arange(0, values.shape[1], size), axis=1))


def morton_order(points: NDArray[np.float64], last: NDArray[np.bool_] | None = None) -> NDArray[np.intp]:
    """(n,) the order of (n, 3) points along a Z-curve; points marked `last`, (n,), come after all others."""
    lo = points.min(axis=0)
    extent = float((points.max(axis=0) - lo).max()) or 1.0
    cells = SPREAD_BITS[((points - lo) * (1023.0 / extent)).astype(np.intp)]
    code = cells[:, 0] | cells[:, 1] << np.uint32(1) | cells[:, 2] << np.uint32(2)
    if last is not None:
        code |= last.astype(np.uint32) << np.uint32(30)
    return np.argsort(code, kind="stable")
