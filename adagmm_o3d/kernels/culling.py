"""Which target points a cluster of source points can reach: whole tiles in, whole tiles out.

The target is cut into tiles of `TILE` points, GROUP tiles form a group, the source is cut into clusters of `CLUSTER`
points; each has a bounding box. Clusters are handed out in chunks, whose partial sums are added in order afterwards:
the same bits for any number of threads.
"""

import numpy as np
from numba import njit

from .compiling import F0, FAST, FLAGS, formulas

TILE = 16
GROUP = 32
CLUSTER = 8
CLUSTERS_PER_CHUNK = 4
CHUNK = CLUSTER * CLUSTERS_PER_CHUNK
BLOCK = 32  # clusters that look for groups together
RUN = 1024  # target points summed in float32 before float64 takes over

rotate_point = formulas.rotate_point


@njit(**FLAGS)
def gap_sq(lo, hi, box_lo, box_hi, i):
    """Squared distance between two axis-aligned boxes; 0 where they meet."""
    gap = 0.0
    for k in range(3):
        d = max(box_lo[k, i] - hi[k], lo[k] - box_hi[k, i], 0.0)
        gap += d * d
    return gap


@njit(**FLAGS)
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

    For the paper's weights. `box` is the cluster's (corners, variance, bits); `sigma` scales the target's variances.
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


# The larger of two is vector code only where NaN is ruled out; points are finite.
REACH_FLAGS = {**FLAGS, "fastmath": FAST | {"nnan"}}


@njit(**REACH_FLAGS)
def reach_groups(box, tiles, groups):
    """Put the groups that a block of source clusters can reach into `groups`; how many they are. See `reach_group`."""
    lo, hi, variance, bits = box
    _, _, _, _, group_lo, group_hi, group_variance, group_bits = tiles
    count = 0
    for g in range(group_lo.shape[1]):
        groups[count] = g
        count += gap_sq(lo, hi, group_lo, group_hi, g) < reach_sq(
            True, variance, bits, group_variance[g], group_bits[g]
        )
    return count


@njit(**REACH_FLAGS)
def reach_group(g, box, tiles, beyond):
    """How many tiles of group g a source cluster can reach, for convolved weights: those whose `beyond` is negative.

    `box` is the cluster's (corners, variance, bits); all variances are at their σ.
    """
    lo, hi, variance, bits = box
    tile_lo, tile_hi, tile_variance, tile_bits, group_lo, group_hi, group_variance, group_bits = tiles
    if gap_sq(lo, hi, group_lo, group_hi, g) >= reach_sq(True, variance, bits, group_variance[g], group_bits[g]):
        return 0
    i, j = g * GROUP, min(tile_lo.shape[1], (g + 1) * GROUP)
    a0, a1, a2 = tile_lo[0, i:j], tile_lo[1, i:j], tile_lo[2, i:j]
    b0, b1, b2 = tile_hi[0, i:j], tile_hi[1, i:j], tile_hi[2, i:j]
    v, b = tile_variance[i:j], tile_bits[i:j]
    l0, l1, l2, h0, h1, h2 = lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]
    hits = 0
    for k in range(v.shape[0]):
        d0 = max(max(a0[k] - h0, l0 - b0[k]), F0)
        d1 = max(max(a1[k] - h1, l1 - b1[k]), F0)
        d2 = max(max(a2[k] - h2, l2 - b2[k]), F0)
        beyond[k] = d0 * d0 + d1 * d1 + d2 * d2 - (variance + v[k]) * min(bits, b[k])
        hits += beyond[k] < F0
    return hits


@njit(**REACH_FLAGS)
def reach_points(tile, box, x, variances, point_bits, beyond, index, count):
    """Put the points of a tile that a source cluster can reach behind the first `count` of `index`; the new count."""
    lo, hi, variance, bits = box
    i, j = tile * TILE, min(variances.shape[0], (tile + 1) * TILE)
    x0, x1, x2, v, b = x[0, i:j], x[1, i:j], x[2, i:j], variances[i:j], point_bits[i:j]
    l0, l1, l2, h0, h1, h2 = lo[0], lo[1], lo[2], hi[0], hi[1], hi[2]
    for k in range(v.shape[0]):
        d0 = max(max(x0[k] - h0, l0 - x0[k]), F0)
        d1 = max(max(x1[k] - h1, l1 - x1[k]), F0)
        d2 = max(max(x2[k] - h2, l2 - x2[k]), F0)
        beyond[k] = d0 * d0 + d1 * d1 + d2 * d2 - (variance + v[k]) * min(bits, b[k])
    for k in range(v.shape[0]):
        index[count] = i + k
        count += beyond[k] < F0
    return count


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


@njit(**FLAGS)
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
