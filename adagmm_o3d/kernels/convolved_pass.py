"""One pass over pairs weighed by convolved Gaussians, N(d; 0, Σx + R Σy Rᵀ): a pair weighs what the density of x - y is
at zero.

Unlike the paper's weights these are shares of a likelihood, so a source point's weights can be divided by the density
of the target mixture plus a uniform one (the points without a partner): the posterior of EM. The same is done for the
target points by a factor for each, from the column sums of the pass before.

A cluster of source points meets only the target points that it can reach. These are copied together first, so that the
loop over pairs stays dense whatever the order of the points.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .compiling import F0, F1, FLAGS, formulas
from .culling import BLOCK, CLUSTER, GROUP, RUN, TILE, cluster_box, largest, reach_group, reach_groups, reach_points
from .exp2 import exp2_float32
from .layout import DENSITY, ROW_SUMS, TOTAL_LIKELIHOOD, TOTAL_MATCHED
from .normal_equations import add_row
from .turning import turn_symmetric

dot = formulas.dot
adjugate, symmetric_product = formulas.adjugate, formulas.symmetric_product

# The rows of a packed target: coordinates, share of the mixture, factor of the weight, matrix at σ (1 or 6 rows).
X, SHARE, FACTOR, MATRIX = 0, 3, 4, 5
# Points are filled up to a multiple of this, the floats of the widest vector register, with points of no weight: no
# pair is left over for scalar code. A tile is as long.
LANES = TILE
# Rows a large power of two apart would all fall on the same few lines of the cache.
SAME_LINES = 256
STRIDE = RUN + 2 * LANES


@njit(**FLAGS)
def row_convolved(
    x0, x1, x2, a0, a1, a2, a3, a4, a5, share, factor, own, y0, y1, y2, b0, b1, b2, b3, b4, b5, columns, row
):  # fmt: skip
    """Add to `row` (layout.ROW_SUMS) and to `columns` the pairs of one source point with a run of target points."""
    w = F0
    e = F0
    density = F0
    p0 = F0
    p1 = F0
    p2 = F0
    p3 = F0
    p4 = F0
    p5 = F0
    u0 = F0
    u1 = F0
    u2 = F0
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        s0 = a0[j] + b0
        s1 = a1[j] + b1
        s2 = a2[j] + b2
        c0, c1, c2, c3, c4, c5 = adjugate(s0, s1, s2, a3[j] + b3, a4[j] + b4, a5[j] + b5)
        root = F1 / math.sqrt(dot(s0, s1, s2, c0, c1, c2))
        inverse = root * root
        vx, vy, vz = symmetric_product(c0, c1, c2, c3, c4, c5, dx, dy, dz)
        q = dot(dx, dy, dz, vx, vy, vz) * inverse
        g = share[j] * root * exp2_float32(-q)
        density += g
        columns[j] += own * g
        c = g * factor[j]
        k = c * inverse
        w += c
        e += c * q
        p0 += k * c0
        p1 += k * c1
        p2 += k * c2
        p3 += k * c3
        p4 += k * c4
        p5 += k * c5
        u0 += k * vx
        u1 += k * vy
        u2 += k * vz
    row[0] += w
    row[1] += e
    row[2] += p0
    row[3] += p1
    row[4] += p2
    row[5] += p3
    row[6] += p4
    row[7] += p5
    row[8] += u0
    row[9] += u1
    row[10] += u2
    row[14] += density


@njit(**FLAGS)
def row_convolved_isotropic(x0, x1, x2, a, share, factor, planar, own, y0, y1, y2, b, columns, row):
    """The same where every covariance is a multiple of the identity."""
    w = F0
    e = F0
    density = F0
    p = F0
    u0 = F0
    u1 = F0
    u2 = F0
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        precision = F1 / (a[j] + b)
        q = precision * dot(dx, dy, dz, dx, dy, dz)
        # |Σ|^(-1/2): the precision to the power D / 2.
        g = share[j] * precision * (F1 if planar else math.sqrt(precision)) * exp2_float32(-q)
        density += g
        columns[j] += own * g
        c = g * factor[j]
        k = c * precision
        w += c
        e += c * q
        p += k
        u0 += k * dx
        u1 += k * dy
        u2 += k * dz
    row[0] += w
    row[1] += e
    row[2] += p
    row[5] += p
    row[7] += p
    row[8] += u0
    row[9] += u1
    row[10] += u2
    row[14] += density


@njit(**FLAGS)
def column_convolved(x0, x1, x2, a0, a1, a2, a3, a4, a5, share, own, y0, y1, y2, b0, b1, b2, b3, b4, b5, columns):
    """Only what one source point adds to `columns`."""
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        s0 = a0[j] + b0
        s1 = a1[j] + b1
        s2 = a2[j] + b2
        c0, c1, c2, c3, c4, c5 = adjugate(s0, s1, s2, a3[j] + b3, a4[j] + b4, a5[j] + b5)
        root = F1 / math.sqrt(dot(s0, s1, s2, c0, c1, c2))
        vx, vy, vz = symmetric_product(c0, c1, c2, c3, c4, c5, dx, dy, dz)
        q = dot(dx, dy, dz, vx, vy, vz) * (root * root)
        columns[j] += own * (share[j] * root * exp2_float32(-q))


@njit(**FLAGS)
def column_convolved_isotropic(x0, x1, x2, a, share, planar, own, y0, y1, y2, b, columns):
    """The same where every covariance is a multiple of the identity."""
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        precision = F1 / (a[j] + b)
        q = precision * dot(dx, dy, dz, dx, dy, dz)
        columns[j] += own * (share[j] * precision * (F1 if planar else math.sqrt(precision)) * exp2_float32(-q))


def pack(points: NDArray[np.float32], weights: NDArray[np.floating], matrix_rows: int) -> NDArray[np.float32]:
    """(5 + matrix_rows, padded n) target for `convolved_pass`: coordinates and weights, factors of one, room for the
    matrices at σ."""
    n = points.shape[1]
    padded = -(-n // LANES) * LANES
    padded += LANES if padded % SAME_LINES == 0 else 0
    packed = np.zeros((MATRIX + matrix_rows, padded), np.float32)
    packed[X:SHARE, :n], packed[SHARE, :n], packed[FACTOR] = points, weights, 1.0
    packed[[MATRIX, MATRIX + 3, MATRIX + 5] if matrix_rows > 1 else MATRIX, n:] = 1.0
    return packed


@njit(**FLAGS)
def cluster_rows(target, i, j, kind, own, y, turned, column, rows):
    """The pairs of a cluster's points with packed target points i..j."""
    planar, isotropic, columns_only = kind
    columns = column[i:j]
    x0, x1, x2, share, factor = (
        target[X, i:j], target[X + 1, i:j], target[X + 2, i:j], target[SHARE, i:j], target[FACTOR, i:j]
    )  # fmt: skip
    for k in range(own.shape[0]):
        y0, y1, y2, b = y[0, k], y[1, k], y[2, k], turned[k]
        if isotropic:
            a = target[MATRIX, i:j]
            if columns_only:
                column_convolved_isotropic(x0, x1, x2, a, share, planar, own[k], y0, y1, y2, b[0], columns)
            else:
                row_convolved_isotropic(
                    x0, x1, x2, a, share, factor, planar, own[k], y0, y1, y2, b[0], columns, rows[k]
                )
        else:
            a0, a1, a2 = target[MATRIX, i:j], target[MATRIX + 1, i:j], target[MATRIX + 2, i:j]
            a3, a4, a5 = target[MATRIX + 3, i:j], target[MATRIX + 4, i:j], target[MATRIX + 5, i:j]
            if columns_only:
                column_convolved(
                    x0, x1, x2, a0, a1, a2, a3, a4, a5, share,
                    own[k], y0, y1, y2, b[0], b[1], b[2], b[3], b[4], b[5], columns,
                )  # fmt: skip
            else:
                row_convolved(
                    x0, x1, x2, a0, a1, a2, a3, a4, a5, share, factor,
                    own[k], y0, y1, y2, b[0], b[1], b[2], b[3], b[4], b[5], columns, rows[k],
                )  # fmt: skip


@njit(**FLAGS)
def gathered_rows(target, index, count, kind, own, y, turned, near, near_column, column, rows):
    """The same with the `count` target points of `index`, copied together and filled up with points of no weight."""
    padded = (count + LANES - 1) // LANES * LANES
    for r in range(target.shape[0]):
        for i in range(count):
            near[r, i] = target[r, index[i]]
        near[r, count:padded] = F0
    for r in (MATRIX, MATRIX + 3, MATRIX + 5) if target.shape[0] > MATRIX + 1 else (MATRIX, MATRIX, MATRIX):
        near[r, count:padded] = F1
    near_column[:padded] = F0
    cluster_rows(near, 0, padded, kind, own, y, turned, near_column, rows)
    for i in range(count):
        column[index[i]] += near_column[i]


@njit(**FLAGS)
def convolved_pass(pose, source, target, tiles, kind, uniform, mutuality, clusters, column, total, densities):
    """The pairs of some source clusters with all of the target, serially.

    source : points (3, M), matrices (1 or 6, M) at σ, weights float64 and float32, largest variances at σ, bits (M,).
    target : packed (6 or 11, padded N) float32, see `pack`; largest variances at σ, bits (N,).
    tiles : the target's, with variances at σ.   kind : (planar, isotropic, columns_only), the last for `column` alone.
    clusters : the first and past the last.
    column : (padded N,) float32, to which the source's density at the target points is added.
    total : (TOTAL_SUMS,), to which the sums are added.
    densities : (M,) receives the target's density at the source points.
    """
    points, matrices, weights, weights32, variances, bits = source
    packed, target_variances, target_bits = target
    planar, isotropic, columns_only = kind
    m_all = points.shape[1]
    tile_count = tiles[0].shape[1]
    still = np.zeros(6, np.float32)
    y = np.empty((3, CLUSTER), np.float32)
    y_block = np.empty((3, BLOCK * CLUSTER), np.float32)
    lo = np.empty(3, np.float32)
    hi = np.empty(3, np.float32)
    turned = np.empty((CLUSTER, 6), np.float32)
    rows = np.empty((CLUSTER, ROW_SUMS), np.float64)
    beyond, beyond_points = np.empty(GROUP, np.float32), np.empty(TILE, np.float32)
    index = np.empty(RUN, np.int32)
    near = np.empty((packed.shape[0], STRIDE), np.float32)
    near_column = np.empty(RUN, np.float32)
    groups = np.empty(tiles[4].shape[1], np.int32)
    group_count = 0
    for cluster in range(clusters[0], clusters[1]):
        if (cluster - clusters[0]) % BLOCK == 0:
            last_cluster = min(cluster + BLOCK, clusters[1])
            m0, m1 = cluster * CLUSTER, min(m_all, last_cluster * CLUSTER)
            cluster_box(pose, points, m0, m1, y_block, lo, hi)
            box = (lo, hi, largest(variances, m0, m1), largest(bits, m0, m1))
            group_count = reach_groups(box, tiles, groups)
        m0 = cluster * CLUSTER
        m1 = min(m_all, m0 + CLUSTER)
        own = weights32[m0:m1]
        cluster_box(pose, points, m0, m1, y, lo, hi)
        box = (lo, hi, largest(variances, m0, m1), largest(bits, m0, m1))
        rows[:] = 0.0
        for m in range(m0, m1):
            turn_symmetric(pose, matrices, F1, isotropic, m, turned[m - m0])
            if planar:
                turned[m - m0, 5] = F1
        count = 0
        for i in range(group_count):
            g = groups[i]
            hits = reach_group(g, box, tiles, beyond)
            first, last = g * GROUP * TILE, min(tile_count, (g + 1) * GROUP) * TILE
            if hits * TILE == last - first:
                cluster_rows(packed, first, last, kind, own, y, turned, column, rows)
            elif hits > 0:
                for t in range(min(GROUP, tile_count - g * GROUP)):
                    if beyond[t] < F0:
                        if count > RUN - TILE:
                            gathered_rows(packed, index, count, kind, own, y, turned, near, near_column, column, rows)
                            count = 0
                        count = reach_points(
                            g * GROUP + t, box, packed, target_variances, target_bits, beyond_points, index, count
                        )
        if count > 0:
            gathered_rows(packed, index, count, kind, own, y, turned, near, near_column, column, rows)
        if columns_only:
            continue
        for m in range(m0, m1):
            k = m - m0
            density = rows[k, DENSITY]
            densities[m] = density
            posterior = 1.0 / (density + uniform)
            total[TOTAL_LIKELIHOOD] += weights[m] * math.log1p(density / uniform)
            total[TOTAL_MATCHED] += weights[m] * density * posterior
            scale = weights[m] * posterior
            if mutuality > 0.0:
                scale *= (posterior * uniform) ** -mutuality
            add_row(rows[k], scale, y[0, k], y[1, k], y[2, k], still, total)
