"""Points and boxes as the device keeps them, and which tile a block has to look at; see `kernels.cpu.culling`.

A tile is TILE points, component by component: (components, TILE) float32. Components are x, y, z, the share that a
pair's weight is multiplied with, and the matrix, packed (6) or its one diagonal entry (1). The last tile is filled up
with copies of the last point whose share is 0. A box is (low corner, high corner, variance, bits).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu import culling
from adagmm_o3d.kernels.cuda.front_end import F0, TILE, exact
from adagmm_o3d.kernels.layout import MATRIX, SHARE, X

BOX_VARIANCE, BOX_BITS = 6, 7

reach_sq = exact(culling.reach_sq.py_func)


class Point(NamedTuple):
    """Three numbers in registers: where a point lies, or how far it is from another."""

    x: Any
    y: Any
    z: Any


class Packed(NamedTuple):
    """A symmetric matrix in registers."""

    xx: Any
    xy: Any
    xz: Any
    yy: Any
    yz: Any
    zz: Any


@exact
def gap_sq(a, i, b, j):
    """Squared distance between boxes a[i] and b[j]; 0 where they meet."""
    gap = F0
    for k in range(3):
        d = max(max(b[j, k] - a[i, k + 3], a[i, k] - b[j, k + 3]), F0)
        gap += d * d
    return gap


@exact
def is_near(convolved, a, i, a_sigma, b, j, b_sigma):
    """Whether any pair of boxes a[i] and b[j] weighs anything, their variances times their σ."""
    limit = reach_sq(
        convolved, a_sigma * a[i, BOX_VARIANCE], a[i, BOX_BITS], b_sigma * b[j, BOX_VARIANCE], b[j, BOX_BITS]
    )
    return gap_sq(a, i, b, j) < limit


@exact
def point_of(tiles, tile, t):
    """Where point t of a tile lies."""
    return Point(tiles[tile, X, t], tiles[tile, X + 1, t], tiles[tile, X + 2, t])


@exact
def packed_matrix_of(tiles, tile, t, scale):
    """Its packed matrix times `scale`."""
    return Packed(
        tiles[tile, MATRIX, t] * scale,
        tiles[tile, MATRIX + 1, t] * scale,
        tiles[tile, MATRIX + 2, t] * scale,
        tiles[tile, MATRIX + 3, t] * scale,
        tiles[tile, MATRIX + 4, t] * scale,
        tiles[tile, MATRIX + 5, t] * scale,
    )


@exact
def isotropic_matrix_of(tiles, tile, t, scale):
    """Its one diagonal entry times `scale`, where every matrix is a multiple of the identity."""
    return tiles[tile, MATRIX, t] * scale


@exact
def extreme(rows, t):
    """Column t of the rows of a block's threads: the least of them in the first three columns, else the greatest."""
    found = rows[0, t]
    for k in range(1, TILE):
        found = min(found, rows[k, t]) if t < 3 else max(found, rows[k, t])
    return found


def tiled(values: NDArray, filler: float | None = None) -> NDArray:
    """(k, n) or (n,) values → (tiles, k, TILE) or (tiles, TILE), filled up with `filler`, else with the last ones."""
    n = values.shape[-1]
    tiles = -(-n // TILE)
    missing = [(0, 0)] * (values.ndim - 1) + [(0, tiles * TILE - n)]
    padded = np.pad(values, missing, mode="edge") if filler is None else np.pad(values, missing, constant_values=filler)
    split = padded.reshape(*values.shape[:-1], tiles, TILE)
    return np.ascontiguousarray(np.moveaxis(split, -2, 0))


def point_tiles(points: NDArray, share: NDArray, matrices: NDArray) -> NDArray[np.float32]:
    """(tiles, 4 + k, TILE) of (3, n) ordered points, (n,) shares and (k, n) matrices."""
    tiles = tiled(np.concatenate([points, share[None], matrices]).astype(np.float32))
    tiles[-1, SHARE, (points.shape[1] - 1) % TILE + 1 :] = 0.0
    return tiles


def boxes(points: NDArray, variances: NDArray, bits: NDArray) -> NDArray[np.float32]:
    """(tiles, 8) boxes of (3, n) ordered points, the largest principal variance and the bits of each."""
    tiles = tiled(points)
    reach = tiled(np.stack([variances, bits]))
    return np.concatenate([tiles.min(axis=2), tiles.max(axis=2), reach.max(axis=2)], axis=1).astype(np.float32)
