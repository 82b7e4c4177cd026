"""Local features that do not know which way a surface faces, and which of two clouds' points look alike by them.

A feature is a fast point feature histogram: how the normals around a point stand to its own, in 3 x 11 bins. Normals
from neighbourhoods have no sign, so here each neighbour's normal is turned to the side of the point's own. What is left
is the sign of the point's own normal: turning it reverses the first and the last histogram, and both are tried when
matching.

Source
------
R. B. Rusu, N. Blodow, M. Beetz: Fast Point Feature Histograms (FPFH) for 3D Registration, ICRA 2009.
"""

import math

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.compiling import FLAGS, SERIAL_KERNEL_FLAGS, source_stamp

BINS = 11
FEATURE = 3 * BINS
# The bins of all turns, from -180 to 180 degrees, share the histogram; normals that face the same way are turned by no
# more than 90. The first of the bins that this leaves, and the tangents of where the others begin.
FIRST_TURN = 2
TURNS = tuple(math.tan(2.0 * math.pi * (b / BINS - 0.5)) for b in range(FIRST_TURN + 1, BINS - FIRST_TURN))


@njit(**FLAGS)
def binned(value):
    """The bin of a value between 0 and 1."""
    return min(max(int(BINS * value), 0), BINS - 1)


@njit(**FLAGS)
def count_pair(points, normals, i, j, histogram):
    """Add how the normal of neighbour j stands to that of point i to the `histogram` of i."""
    dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
    length = math.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / length, dy / length, dz / length
    ax, ay, az = normals[i, 0], normals[i, 1], normals[i, 2]
    bx, by, bz = normals[j, 0], normals[j, 1], normals[j, 2]
    if ax * bx + ay * by + az * bz < 0.0:
        bx, by, bz = -bx, -by, -bz
    slope, other = ax * dx + ay * dy + az * dz, bx * dx + by * dy + bz * dz
    # The frame stands on the point whose normal is nearer to the line between both.
    if abs(slope) < abs(other):
        ax, ay, az, bx, by, bz = bx, by, bz, ax, ay, az
        dx, dy, dz, slope = -dx, -dy, -dz, -other
    vx, vy, vz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    length = math.sqrt(vx * vx + vy * vy + vz * vz)
    if length < 1e-9:
        return
    vx, vy, vz = vx / length, vy / length, vz / length
    wx, wy, wz = ay * vz - az * vy, az * vx - ax * vz, ax * vy - ay * vx
    across, along = wx * bx + wy * by + wz * bz, ax * bx + ay * by + az * bz
    turn = FIRST_TURN
    for slope_of_bin in TURNS:
        turn += across >= slope_of_bin * along
    histogram[turn] += 1.0
    histogram[BINS + binned(0.5 * (vx * bx + vy * by + vz * bz + 1.0))] += 1.0
    histogram[2 * BINS + binned(0.5 * (slope + 1.0))] += 1.0


def _build(stamp):
    """The kernels that are called from Python; `stamp` keeps their cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def scatter_around(points, queries, radius, scatter):
        """`scatter` (k, 3, 3) receives the covariance of the (n, 3) points within `radius` of each query (k, 3); both
        in ascending x."""
        _ = stamp
        sums = np.empty(10)
        first = 0
        for q in range(len(queries)):
            sums[:] = 0.0
            x, y, z = queries[q, 0], queries[q, 1], queries[q, 2]
            while first < len(points) and points[first, 0] < x - radius:
                first += 1
            i = first
            while i < len(points) and points[i, 0] <= x + radius:
                dx, dy, dz = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
                if dx * dx + dy * dy + dz * dz <= radius * radius:
                    sums[0] += 1.0
                    sums[1] += dx
                    sums[2] += dy
                    sums[3] += dz
                    sums[4] += dx * dx
                    sums[5] += dx * dy
                    sums[6] += dx * dz
                    sums[7] += dy * dy
                    sums[8] += dy * dz
                    sums[9] += dz * dz
                i += 1
            count = max(sums[0], 1.0)
            place = 4
            for a in range(3):
                for b in range(a, 3):
                    value = sums[place] / count - sums[1 + a] / count * (sums[1 + b] / count)
                    scatter[q, a, b], scatter[q, b, a] = value, value
                    place += 1

    @njit(**SERIAL_KERNEL_FLAGS)
    def describe(points, normals, radius, features):
        """`features` (n, FEATURE) of (n, 3) points in ascending x with unit normals, from their neighbours within
        `radius`."""
        _ = stamp
        n = len(points)
        neighbors, counts = np.empty((n, n), np.int32), np.zeros(n, np.int64)
        first = 0
        for i in range(n):
            while points[first, 0] < points[i, 0] - radius:
                first += 1
            j = first
            while j < n and points[j, 0] <= points[i, 0] + radius:
                dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
                d = dx * dx + dy * dy + dz * dz
                if 0.0 < d <= radius * radius:
                    neighbors[i, counts[i]] = j
                    counts[i] += 1
                j += 1
        simple = np.zeros((n, FEATURE))
        for i in range(n):
            for k in range(counts[i]):
                count_pair(points, normals, i, neighbors[i, k], simple[i])
            for b in range(FEATURE):
                simple[i, b] *= 100.0 / max(counts[i], 1)
        around = np.empty(FEATURE)
        for i in range(n):
            around[:] = 0.0
            for k in range(counts[i]):
                j = neighbors[i, k]
                dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
                share = 1.0 / (dx * dx + dy * dy + dz * dz)
                agreement = (
                    normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1] + normals[i, 2] * normals[j, 2]
                )
                if agreement < 0.0:
                    for b in range(BINS):
                        around[b] += share * simple[j, BINS - 1 - b]
                        around[2 * BINS + b] += share * simple[j, FEATURE - 1 - b]
                else:
                    for b in range(BINS):
                        around[b] += share * simple[j, b]
                        around[2 * BINS + b] += share * simple[j, 2 * BINS + b]
                for b in range(BINS, 2 * BINS):
                    around[b] += share * simple[j, b]
            for part in range(0, FEATURE, BINS):
                total = 0.0
                for b in range(part, part + BINS):
                    total += around[b]
                scale = 100.0 / total if total > 0.0 else 0.0
                for b in range(part, part + BINS):
                    features[i, b] = scale * around[b] + simple[i, b]

    @njit(**SERIAL_KERNEL_FLAGS)
    def nearest_features(own, others, turned, best, least, best_other, least_other):
        """For each of (n, FEATURE) float32 features its nearest among (FEATURE, m) `others`, or among the same features
        of points whose normals are `turned`, whichever is nearer, in `best` (n,), and the squared distances of the
        nearest and of the second nearest in `least` (n, 2); `best_other` (m,) and `least_other` (m, 2) the other way.
        """
        _ = stamp
        m = others.shape[1]
        straight, reverse = np.empty(m, np.float32), np.empty(m, np.float32)
        least_other[:] = np.inf
        best_other[:] = 0
        for i in range(own.shape[0]):
            straight[:] = np.float32(0.0)
            reverse[:] = np.float32(0.0)
            for b in range(BINS):
                u, v, w = own[i, b], own[i, BINS + b], own[i, 2 * BINS + b]
                for j in range(m):
                    d, e, f = u - others[b, j], v - others[BINS + b, j], w - others[2 * BINS + b, j]
                    straight[j] += d * d + e * e + f * f
                for j in range(m):
                    d, e, f = u - turned[b, j], v - turned[BINS + b, j], w - turned[2 * BINS + b, j]
                    reverse[j] += d * d + e * e + f * f
            nearest, second, place = np.float32(np.inf), np.float32(np.inf), 0
            for j in range(m):
                square = min(straight[j], reverse[j])
                if square < second:
                    if square < nearest:
                        second, nearest, place = nearest, square, j
                    else:
                        second = square
                if square < least_other[j, 1]:
                    if square < least_other[j, 0]:
                        least_other[j, 1], least_other[j, 0], best_other[j] = least_other[j, 0], square, i
                    else:
                        least_other[j, 1] = square
            best[i], least[i, 0], least[i, 1] = place, nearest, second

    return scatter_around, describe, nearest_features


scatter_around, describe, nearest_features = _build(source_stamp())
