"""Distance from each source point to its nearest target point."""

import numpy as np
from numba import njit, prange

from adagmm_o3d.kernels.cpu.compiling import FAST, FLAGS, KERNEL_FLAGS, formulas, source_stamp
from adagmm_o3d.kernels.cpu.culling import (
    CHUNK,
    CLUSTER,
    CLUSTERS_PER_CHUNK,
    GROUP,
    TILE,
    closest_tile,
    cluster_box,
    gap_sq,
)

dot = formulas.dot


# The smaller of two is vector code only where NaN is ruled out; points are finite.
@njit(**{**FLAGS, "fastmath": FAST | {"nnan"}})
def row_nearest_sq(x0, x1, x2, y0, y1, y2):
    """Squared distance from one source point to the nearest of a run of target points."""
    best = np.float32(np.inf)
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        best = min(best, dot(dx, dy, dz, dx, dy, dz))
    return best


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def nearest_sq(pose, points, x, tiles, nearest):
        """`nearest` (M,) receives the distances of the points (3, M) at `pose` (12,) to those of `x` (3, N)."""
        _ = stamp
        box_lo, box_hi, _, _, group_lo, group_hi, _, _ = tiles
        count = box_lo.shape[1]
        for chunk in prange((points.shape[1] + CHUNK - 1) // CHUNK):
            y = np.empty((3, CLUSTER), np.float32)
            lo = np.empty(3, np.float32)
            hi = np.empty(3, np.float32)
            for cluster in range(chunk * CLUSTERS_PER_CHUNK, (chunk + 1) * CLUSTERS_PER_CHUNK):
                m0 = cluster * CLUSTER
                m1 = min(points.shape[1], m0 + CLUSTER)
                if m0 >= m1:
                    break
                cluster_box(pose, points, m0, m1, y, lo, hi)
                nearest[m0:m1] = np.inf
                worst = np.inf
                start = closest_tile(lo, hi, box_lo, box_hi, group_lo, group_hi)
                for g in range(-1, group_lo.shape[1]):
                    if g >= 0 and gap_sq(lo, hi, group_lo, group_hi, g) >= worst:
                        continue
                    first = start if g < 0 else g * GROUP
                    last = start + 1 if g < 0 else min(count, first + GROUP)
                    for tile in range(first, last):
                        if (g >= 0 and tile == start) or gap_sq(lo, hi, box_lo, box_hi, tile) >= worst:
                            continue
                        i = tile * TILE
                        j = min(x.shape[1], i + TILE)
                        worst = 0.0
                        for m in range(m0, m1):
                            k = m - m0
                            d = row_nearest_sq(x[0, i:j], x[1, i:j], x[2, i:j], y[0, k], y[1, k], y[2, k])
                            nearest[m] = min(nearest[m], d)
                            worst = max(worst, nearest[m])

    return nearest_sq


nearest_sq = _build(source_stamp())
