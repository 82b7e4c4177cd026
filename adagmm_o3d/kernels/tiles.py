"""Points put in an order in which neighbours lie together, cut into tiles with bounding boxes: what culling works on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .cpu import GROUP, TILE

Float32 = NDArray[np.float32]


class Tiles(NamedTuple):
    """Boxes of runs of TILE points and of groups of GROUP tiles, (3, count), and the largest reach² at σ = 1 in each."""

    lo: Float32
    hi: Float32
    reach_sq: Float32
    group_lo: Float32
    group_hi: Float32
    group_reach_sq: Float32


def make_tiles(points: Float32, reaches_sq: Float32) -> Tiles:
    """The tiles of (3, n) ordered points with (n,) squared reaches."""
    lo, hi = _reduce(np.minimum, points, TILE), _reduce(np.maximum, points, TILE)
    reach_sq = _reduce(np.maximum, reaches_sq[None], TILE)
    group_reach_sq = _reduce(np.maximum, reach_sq, GROUP)
    return Tiles(
        lo, hi, reach_sq[0], _reduce(np.minimum, lo, GROUP), _reduce(np.maximum, hi, GROUP), group_reach_sq[0]
    )


def _reduce(ufunc: np.ufunc, values: Float32, size: int) -> Float32:
    return np.ascontiguousarray(ufunc.reduceat(values, np.arange(0, values.shape[1], size), axis=1))


def morton_order(points: NDArray[np.float64], last: NDArray[np.bool_]) -> NDArray[np.intp]:
    """(n,) the order of (n, 3) points along a Z-curve; points marked `last` come after all others."""
    lo = points.min(axis=0)
    extent = float((points.max(axis=0) - lo).max()) or 1.0
    cells = ((points - lo) * (1023.0 / extent)).astype(np.uint32)
    code = np.zeros(len(points), np.uint32)
    for axis in range(3):
        code |= _spread_bits(cells[:, axis]) << np.uint32(axis)
    code |= last.astype(np.uint32) << np.uint32(30)
    return np.argsort(code, kind="stable")


def _spread_bits(v: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Ten bits, two zeros after each."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        v = (v | (v << np.uint32(shift))) & np.uint32(mask)
    return v
