"""The scores of points on the GPU, as `kernels.cpu.scores` adds them up: what the pose covariance is made of.

Pairs are evaluated and summed up in float32, a point's threads are put together in float64. Of the symmetric sums only
the upper triangle is kept.
"""

import math

import numpy as np
from numba import float64, int32

from adagmm_o3d.kernels import layout
from adagmm_o3d.kernels.cuda.front_end import F0, F1, TILE, cuda, fast, fast_kernel, formulas, source_stamp
from adagmm_o3d.kernels.cuda.reductions import PADDED, reduce_tile
from adagmm_o3d.kernels.cuda.tiles import BOX_VARIANCE, isotropic_matrix_of, packed_matrix_of, point_of

symmetric_product, dot, cross = formulas.symmetric_product, formulas.dot, formulas.cross
convolved_full = formulas.convolved_full

# Sums of a point: score (6), sensitivity (6), then for source points curvature (21), row by row.
SENSITIVITY, CURVATURE, SUMS = 6, 12, 33
# What a point is made of: place, covariance, largest variance.
POINT = 10
# Where the entries of a symmetric 6x6 matrix are in its upper triangle.
TRIANGLE = np.array(
    [[6 * min(i, j) - min(i, j) * (min(i, j) + 1) // 2 + max(i, j) for j in range(6)] for i in range(6)]
).ravel()
HALF = np.float32(0.5)
NONE, NOTHING = (F0,) * CURVATURE, (F0,) * SUMS


def unfolded(sums):
    """(SUMS or CURVATURE, K) sums → (K, POINT_SUMS) as `kernels.cpu.scores` lays them out, 0 where there are none."""
    rows = np.zeros((sums.shape[1], layout.POINT_SUMS))
    rows[:, : layout.CURVATURE] = sums[:CURVATURE].T
    if len(sums) == SUMS:
        rows[:, layout.CURVATURE :] = sums[CURVATURE + TRIANGLE].T
    return rows


@fast
def geometry(d, a, b, cut):
    """Of a pair with offset d (3) and packed covariances a and b (6), S their sum: S⁻¹ (6), S⁻¹ d (3), and its density,
    0 beyond the cut."""
    height, inverse, q, v0, v1, v2, c0, c1, c2, c3, c4, c5 = convolved_full(
        F1, d[0], d[1], d[2],
        a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5],
    )  # fmt: skip
    precision = c0 * inverse, c1 * inverse, c2 * inverse, c3 * inverse, c4 * inverse, c5 * inverse
    density = F0 if q > cut else height * math.exp(-HALF * q)
    return precision, (v0 * inverse, v1 * inverse, v2 * inverse), density


@fast
def turning(y, b, c, v):
    """y x v (3), and that with what the turn of B adds, -∂(log density)/∂ω (3); and B v (3)."""
    b0, b1, b2, b3, b4, b5 = b
    c0, c1, c2, c3, c4, c5 = c
    v0, v1, v2 = v
    p0, p1, p2 = symmetric_product(b0, b1, b2, b3, b4, b5, v0, v1, v2)
    t0, t1, t2 = cross(p0, p1, p2, v0, v1, v2)
    j0, j1, j2 = cross(y[0], y[1], y[2], v0, v1, v2)
    # B S⁻¹, column by column
    _, f10, f20 = symmetric_product(b0, b1, b2, b3, b4, b5, c0, c1, c2)
    f01, _, f21 = symmetric_product(b0, b1, b2, b3, b4, b5, c1, c3, c4)
    f02, f12, _ = symmetric_product(b0, b1, b2, b3, b4, b5, c2, c4, c5)
    return (j0, j1, j2), (j0 + f12 - f21 - t0, j1 + f20 - f02 - t1, j2 + f01 - f10 - t2), (p0, p1, p2)


@fast
def scored(y, d, a, b, cut, weight, share, s):
    """The sums `s` of a point with a pair added: source point y (3) with covariance b (6, packed), offset d (3), target
    covariance a (6)."""
    c, v, density = geometry(d, a, b, cut)
    (j0, j1, j2), (g0, g1, g2), _ = turning(y, b, c, v)
    v0, v1, v2 = v
    w, e = weight * density, share * density
    return (
        s[0] + w * j0,
        s[1] + w * j1,
        s[2] + w * j2,
        s[3] + w * v0,
        s[4] + w * v1,
        s[5] + w * v2,
        s[6] + e * g0,
        s[7] + e * g1,
        s[8] + e * g2,
        s[9] + e * v0,
        s[10] + e * v1,
        s[11] + e * v2,
    )


@fast
def curved(y, d, a, b, cut, weight, share, s):
    """The same with the curvature."""
    c, v, density = geometry(d, a, b, cut)
    (j0, j1, j2), (g0, g1, g2), (p0, p1, p2) = turning(y, b, c, v)
    y0, y1, y2 = y
    v0, v1, v2 = v
    b0, b1, b2, b3, b4, b5 = b
    c0, c1, c2, c3, c4, c5 = c
    w, e = weight * density, share * density
    # S ∂(S⁻¹ d)/∂ω is -[y - B v]ₓ - B [v]ₓ; h is S⁻¹ times that, column by column, and r what it does to y x v.
    x0, x1, x2 = p0 - y0, p1 - y1, p2 - y2
    m0, m1, m2 = symmetric_product(b0, b1, b2, b3, b4, b5, F0, v2, -v1)
    h00, h10, h20 = symmetric_product(c0, c1, c2, c3, c4, c5, -m0, x2 - m1, -x1 - m2)
    m0, m1, m2 = symmetric_product(b0, b1, b2, b3, b4, b5, -v2, F0, v0)
    h01, h11, h21 = symmetric_product(c0, c1, c2, c3, c4, c5, -x2 - m0, -m1, x0 - m2)
    m0, m1, m2 = symmetric_product(b0, b1, b2, b3, b4, b5, v1, -v0, F0)
    h02, h12, h22 = symmetric_product(c0, c1, c2, c3, c4, c5, x1 - m0, -x0 - m1, -m2)
    # the lever arm turns too: (ω x y) x v = y (ω·v) - ω (y·v)
    along = dot(y0, y1, y2, v0, v1, v2)
    r00, r10, r20 = cross(y0, y1, y2, h00, h10, h20)
    r01, r11, r21 = cross(y0, y1, y2, h01, h11, h21)
    r02, r12, r22 = cross(y0, y1, y2, h02, h12, h22)
    # [y]ₓ S⁻¹, column by column
    k00, k10, k20 = cross(y0, y1, y2, c0, c1, c2)
    k01, k11, k21 = cross(y0, y1, y2, c1, c3, c4)
    k02, k12, k22 = cross(y0, y1, y2, c2, c4, c5)
    u = HALF * w
    return (
        s[0] + w * j0,
        s[1] + w * j1,
        s[2] + w * j2,
        s[3] + w * v0,
        s[4] + w * v1,
        s[5] + w * v2,
        s[6] + e * g0,
        s[7] + e * g1,
        s[8] + e * g2,
        s[9] + e * v0,
        s[10] + e * v1,
        s[11] + e * v2,
        s[12] + w * (r00 + y0 * v0 - j0 * g0 - along),
        s[13] + u * (r01 + y0 * v1 - j0 * g1 + r10 + y1 * v0 - j1 * g0),
        s[14] + u * (r02 + y0 * v2 - j0 * g2 + r20 + y2 * v0 - j2 * g0),
        s[15] + u * (k00 - j0 * v0 + h00 - v0 * g0),
        s[16] + u * (k01 - j0 * v1 + h10 - v1 * g0),
        s[17] + u * (k02 - j0 * v2 + h20 - v2 * g0),
        s[18] + w * (r11 + y1 * v1 - j1 * g1 - along),
        s[19] + u * (r12 + y1 * v2 - j1 * g2 + r21 + y2 * v1 - j2 * g1),
        s[20] + u * (k10 - j1 * v0 + h01 - v0 * g1),
        s[21] + u * (k11 - j1 * v1 + h11 - v1 * g1),
        s[22] + u * (k12 - j1 * v2 + h21 - v2 * g1),
        s[23] + w * (r22 + y2 * v2 - j2 * g2 - along),
        s[24] + u * (k20 - j2 * v0 + h02 - v0 * g2),
        s[25] + u * (k21 - j2 * v1 + h12 - v1 * g2),
        s[26] + u * (k22 - j2 * v2 + h22 - v2 * g2),
        s[27] + w * (c0 - v0 * v0),
        s[28] + w * (c1 - v0 * v1),
        s[29] + w * (c2 - v0 * v2),
        s[30] + w * (c3 - v1 * v1),
        s[31] + w * (c4 - v1 * v2),
        s[32] + w * (c5 - v2 * v2),
    )


@fast
def is_in_reach(own, k, boxes, tile, spread, cut):
    """Whether a pair of point k with the points of a box can lie within the cut, their variances times `spread`."""
    gap = F0
    for i in range(3):
        d = max(max(boxes[tile, i] - own[i, k], own[i, k] - boxes[tile, i + 3]), F0)
        gap += d * d
    return gap <= cut * (own[POINT - 1, k] + spread * boxes[tile, BOX_VARIANCE])


def _build(of_source, isotropic, stamp):
    """The kernel for points of the source, with all sums, or of the target, with the first CURVATURE of them.

    isotropic : of the matrices in the tiles.
    """
    count_of_sums = SUMS if of_source else CURVATURE

    @fast_kernel
    def score_sums(own, other, boxes, scale, spread, weights, shares, cut, sums):
        """One block for each point k, whose threads take one point of a tile each, tile by tile.

        own : (POINT, K) float32.   other : (tiles, 4 + 1 or 6, TILE) the tiles of the other cloud, their matrices times
        `scale` its covariances; boxes : theirs, their variances times `spread`.   weights, shares : (tiles, TILE)
        float32 of the other's points.   sums : (count_of_sums, K) float64, overwritten.
        """
        _ = stamp
        near = cuda.shared.array(TILE, int32)
        block = cuda.shared.array((count_of_sums, PADDED), float64)
        t = cuda.threadIdx.x
        k = cuda.blockIdx.x
        p = own[0, k], own[1, k], own[2, k]
        q = own[3, k], own[4, k], own[5, k], own[6, k], own[7, k], own[8, k]
        count = other.shape[0]
        s = NOTHING if of_source else NONE
        for first in range(0, count, TILE):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t
            found = 0
            if tile < count and is_in_reach(own, k, boxes, tile, spread, cut):
                found = 1
            near[t] = found
            if cuda.syncthreads_or(found) == 0:
                continue
            for i in range(TILE):
                if near[i] == 0:
                    continue
                tile = first + i
                x = point_of(other, tile, t)
                if isotropic:
                    m0 = isotropic_matrix_of(other, tile, t, scale)
                    m = m0, F0, F0, m0, F0, m0
                else:
                    m = packed_matrix_of(other, tile, t, scale)
                weight, share = weights[tile, t], shares[tile, t]
                if of_source:
                    s = curved(p, (p[0] - x[0], p[1] - x[1], p[2] - x[2]), m, q, cut, weight, share, s)
                else:
                    s = scored(x, (x[0] - p[0], x[1] - p[1], x[2] - p[2]), q, m, cut, weight, share, s)
            cuda.syncthreads()
        block[0, t] = s[0]
        block[1, t] = s[1]
        block[2, t] = s[2]
        block[3, t] = s[3]
        block[4, t] = s[4]
        block[5, t] = s[5]
        block[6, t] = s[6]
        block[7, t] = s[7]
        block[8, t] = s[8]
        block[9, t] = s[9]
        block[10, t] = s[10]
        block[11, t] = s[11]
        if of_source:
            block[12, t] = s[12]
            block[13, t] = s[13]
            block[14, t] = s[14]
            block[15, t] = s[15]
            block[16, t] = s[16]
            block[17, t] = s[17]
            block[18, t] = s[18]
            block[19, t] = s[19]
            block[20, t] = s[20]
            block[21, t] = s[21]
            block[22, t] = s[22]
            block[23, t] = s[23]
            block[24, t] = s[24]
            block[25, t] = s[25]
            block[26, t] = s[26]
            block[27, t] = s[27]
            block[28, t] = s[28]
            block[29, t] = s[29]
            block[30, t] = s[30]
            block[31, t] = s[31]
            block[32, t] = s[32]
        cuda.syncthreads()
        reduce_tile(block, count_of_sums, t, k, sums)

    return score_sums


score_sums_of_source = _build(True, False, source_stamp())
score_sums_of_source_isotropic = _build(True, True, source_stamp())
score_sums_of_target = _build(False, False, source_stamp())
score_sums_of_target_isotropic = _build(False, True, source_stamp())
