"""Which target points a cluster of source points can reach: whole tiles in, whole tiles out.

The target is cut into tiles of `TILE` points, GROUP tiles form a group, the source is cut into clusters of `CLUSTER`
points; each has a bounding box. Clusters are handed out in chunks, whose partial sums are added in order afterwards:
the same bits for any number of threads.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.compiling import F0, FLAGS, POINTWISE_FLAGS, pointwise_formulas

TILE = 16
GROUP = 32
CLUSTER = 8
CLUSTERS_PER_CHUNK = 4
CHUNK = CLUSTER * CLUSTERS_PER_CHUNK
BLOCK = 32  # clusters that look for groups together
RUN = 1024  # target points summed in float32 before float64 takes over

rotate_point = pointwise_formulas.rotate_point


class Box(NamedTuple):
    """A source cluster: its corners (3,), the largest variance of its points, and their most bits, see `reach_sq`."""

    lo: NDArray[np.float32]
    hi: NDArray[np.float32]
    variance: np.float32
    bits: np.float32


class Boxes(NamedTuple):
    """The same of tiles, groups or points of a target: corners (3, count), variances and bits (count,)."""

    lo: NDArray[np.float32]
    hi: NDArray[np.float32]
    variances: NDArray[np.float32]
    bits: NDArray[np.float32]


@njit(**FLAGS)
def gap_sq(lo, hi, box_lo, box_hi, i):
    """Squared distance between two axis-aligned boxes; 0 where they meet."""
    gap = 0.0
    for k in range(3):
        d = max(box_lo[k, i] - hi[k], lo[k] - box_hi[k, i], 0.0)
        gap += d * d
    return gap


# The larger of two is vector code only where NaN is ruled out; points are finite.
REACH_FLAGS = {**POINTWISE_FLAGS, "fastmath": {"nnan", "nsz"}}


@njit(**REACH_FLAGS)
def reach_sq(convolved, variance, bits, other_variance, other_bits):
    """Squared distance beyond which no pair of two groups of points weighs anything.

    `variance` is the largest principal variance in a group (times σ), `bits` the powers of two by which a weight may
    fall before it is lost, fewer for vague points. The paper's weight lives as long as either point's own Gaussian
    does; a convolved one has the sum of the variances and at most the amplitude of the vaguer point.
    """
    if convolved:
        return (variance + other_variance) * min(bits, other_bits)
    return max(variance * bits, other_variance * other_bits)


@njit(**FLAGS)
def next_run(tile, box, sigma, tiles, n):
    """The next run of target points within reach of a source cluster, from `tile` on: (first, past last, next tile).

    For the paper's weights. `sigma` scales the target's variances.
    Groups of GROUP tiles are skipped whole. A run ends at the first tile out of reach or after RUN points.
    """
    lo, hi, variance, bits = box
    tile_lo, tile_hi, tile_variance, tile_bits, group_lo, group_hi, group_variance, group_bits = tiles
    count = tile_lo.shape[1]
    first = -1
    while tile < count:
        if first < 0 and tile % GROUP == 0:
            g = tile // GROUP
            limit = reach_sq(False, variance, bits, sigma * group_variance[g], group_bits[g])
            if gap_sq(lo, hi, group_lo, group_hi, g) >= limit:
                tile += GROUP
                continue
        limit = reach_sq(False, variance, bits, sigma * tile_variance[tile], tile_bits[tile])
        if gap_sq(lo, hi, tile_lo, tile_hi, tile) >= limit:
            if first >= 0:
                break
        elif first < 0:
            first = tile * TILE
        tile += 1
        if first >= 0 and tile * TILE - first >= RUN:
            break
    if first < 0:
        return n, n, count
    return first, min(n, tile * TILE), tile


@njit(**REACH_FLAGS)
def reach(i, j, box, others, beyond):
    """How many of the boxes i..j a source cluster can reach, for convolved weights: those whose `beyond` is negative.

    box, others : `Box` and `Boxes`, all variances at their σ. A point is a box without extent.
    """
    lo, hi, variance, bits = box
    other_lo, other_hi, other_variances, other_bits = others
    l0, l1, l2, h0, h1, h2 = lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]
    hits = 0
    # An unsigned index cannot count from the end, which would keep neighbours from being loaded as a vector.
    first = np.uint64(i)
    for n in range(first, np.uint64(j)):
        d0 = max(max(other_lo[0, n] - h0, l0 - other_hi[0, n]), F0)
        d1 = max(max(other_lo[1, n] - h1, l1 - other_hi[1, n]), F0)
        d2 = max(max(other_lo[2, n] - h2, l2 - other_hi[2, n]), F0)
        limit = reach_sq(True, variance, bits, other_variances[n], other_bits[n])
        beyond[n - first] = d0 * d0 + d1 * d1 + d2 * d2 - limit
        hits += beyond[n - first] < F0
    return hits


@njit(**FLAGS)
def closest_tile(lo, hi, box_lo, box_hi, group_lo, group_hi):
    """The tile whose box is nearest to the box (lo, hi); where to begin the search."""
    best, closest = np.inf, 0
    for g in range(group_lo.shape[1]):
        if gap_sq(lo, hi, group_lo, group_hi, g) >= best:
            continue
        for tile in range(g * GROUP, min(box_lo.shape[1], (g + 1) * GROUP)):
            gap = gap_sq(lo, hi, box_lo, box_hi, tile)
            if gap < best:
                best, closest = gap, tile
    return closest


@njit(**POINTWISE_FLAGS)
def cluster_box(pose, points, m0, m1, y, lo, hi):
    """Move source points m0..m1 into `y` and the corners of their box into `lo`, `hi`."""
    lo[:] = np.inf
    hi[:] = -np.inf
    for m in range(m0, m1):
        k = m - m0
        y[0, k], y[1, k], y[2, k] = rotate_point(pose, points[0, m], points[1, m], points[2, m])
        for i in range(3):
            lo[i] = min(lo[i], y[i, k])
            hi[i] = max(hi[i], y[i, k])


@njit(**FLAGS)
def largest(values, m0, m1):
    """The largest of values[m0:m1]."""
    most = values[m0]
    for m in range(m0 + 1, m1):
        most = max(most, values[m])
    return most
