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
from adagmm_o3d.kernels.cuda.shared_tile import colour_of, combined, no_colour_of, offset
from adagmm_o3d.kernels.cuda.tiles import BOX_VARIANCE, Packed, Point, isotropic_matrix_of, packed_matrix_of, point_of
from adagmm_o3d.kernels.cuda.tuples import adder, column_storer

symmetric_product, dot, cross = formulas.symmetric_product, formulas.dot, formulas.cross
convolved_full = formulas.convolved_full
capped_distance, density_of = formulas.capped_distance, formulas.density_of

# Sums of a point: score (6), sensitivity (6), then for source points curvature (21), row by row.
SENSITIVITY, CURVATURE, SUMS = 6, 12, 33
# What a point is made of: place, covariance, largest variance.
POINT = 10
# Where the entries of a symmetric 6x6 matrix are in its upper triangle.
TRIANGLE = np.array(
    [[6 * min(i, j) - min(i, j) * (min(i, j) + 1) // 2 + max(i, j) for j in range(6)] for i in range(6)]
).ravel()
HALF = np.float32(0.5)


def unfolded(sums):
    """(SUMS or CURVATURE, K) sums → (K, POINT_SUMS) as `kernels.cpu.scores` lays them out, 0 where there are none."""
    rows = np.zeros((sums.shape[1], layout.POINT_SUMS))
    rows[:, : layout.CURVATURE] = sums[:CURVATURE].T
    if len(sums) == SUMS:
        rows[:, layout.CURVATURE :] = sums[CURVATURE + TRIANGLE].T
    return rows


@fast
def geometry(d, a, b, cut, likeness):
    """Of a pair with offset d and covariances a and b, S their sum: S⁻¹, S⁻¹ d, and its density times `likeness`, what
    its colours make of it, 0 beyond the cut."""
    s = combined(a, b)
    height, inverse, q, v0, v1, v2, c0, c1, c2, c3, c4, c5 = convolved_full(
        F1, d.x, d.y, d.z, s.xx, s.xy, s.xz, s.yy, s.yz, s.zz
    )
    precision = Packed(c0 * inverse, c1 * inverse, c2 * inverse, c3 * inverse, c4 * inverse, c5 * inverse)
    density = F0 if q > cut else likeness * height * math.exp(-HALF * q)
    return precision, Point(v0 * inverse, v1 * inverse, v2 * inverse), density


@fast
def product(p, x, y, z):
    """P · (x, y, z)."""
    return symmetric_product(p.xx, p.xy, p.xz, p.yy, p.yz, p.zz, x, y, z)


@fast
def turning(y, b, c, v):
    """y x v, and that with what the turn of B adds, -∂(log density)/∂ω; and B v; C = S⁻¹, v = S⁻¹ d."""
    p0, p1, p2 = product(b, v.x, v.y, v.z)
    t0, t1, t2 = cross(p0, p1, p2, v.x, v.y, v.z)
    j0, j1, j2 = cross(y.x, y.y, y.z, v.x, v.y, v.z)
    # B S⁻¹, column by column
    _, f10, f20 = product(b, c.xx, c.xy, c.xz)
    f01, _, f21 = product(b, c.xy, c.yy, c.yz)
    f02, f12, _ = product(b, c.xz, c.yz, c.zz)
    return Point(j0, j1, j2), Point(j0 + f12 - f21 - t0, j1 + f20 - f02 - t1, j2 + f01 - f10 - t2), Point(p0, p1, p2)


@fast
def scored(y, d, a, b, cut, likeness, weight, share):
    """What a pair adds to the sums of a point: source point y with covariance b, offset d, target covariance a,
    and what the colours make of it."""
    c, v, density = geometry(d, a, b, cut, likeness)
    j, g, _ = turning(y, b, c, v)
    w, e = weight * density, share * density
    return (
        w * j.x, w * j.y, w * j.z, w * v.x, w * v.y, w * v.z,
        e * g.x, e * g.y, e * g.z, e * v.x, e * v.y, e * v.z,
    )  # fmt: skip


@fast
def curved(y, d, a, b, cut, likeness, weight, share):
    """The same with the curvature."""
    c, v, density = geometry(d, a, b, cut, likeness)
    j, g, p = turning(y, b, c, v)
    w, e = weight * density, share * density
    # S ∂(S⁻¹ d)/∂ω is -[y - B v]ₓ - B [v]ₓ; h is S⁻¹ times that, column by column, and r what it does to y x v.
    x = offset(p, y)
    m0, m1, m2 = product(b, F0, v.z, -v.y)
    h00, h10, h20 = product(c, -m0, x.z - m1, -x.y - m2)
    m0, m1, m2 = product(b, -v.z, F0, v.x)
    h01, h11, h21 = product(c, -x.z - m0, -m1, x.x - m2)
    m0, m1, m2 = product(b, v.y, -v.x, F0)
    h02, h12, h22 = product(c, x.y - m0, -x.x - m1, -m2)
    # the lever arm turns too: (ω x y) x v = y (ω·v) - ω (y·v)
    along = dot(y.x, y.y, y.z, v.x, v.y, v.z)
    r00, r10, r20 = cross(y.x, y.y, y.z, h00, h10, h20)
    r01, r11, r21 = cross(y.x, y.y, y.z, h01, h11, h21)
    r02, r12, r22 = cross(y.x, y.y, y.z, h02, h12, h22)
    # [y]ₓ S⁻¹, column by column
    k00, k10, k20 = cross(y.x, y.y, y.z, c.xx, c.xy, c.xz)
    k01, k11, k21 = cross(y.x, y.y, y.z, c.xy, c.yy, c.yz)
    k02, k12, k22 = cross(y.x, y.y, y.z, c.xz, c.yz, c.zz)
    u = HALF * w
    return (
        w * j.x, w * j.y, w * j.z, w * v.x, w * v.y, w * v.z,
        e * g.x, e * g.y, e * g.z, e * v.x, e * v.y, e * v.z,
        # row by row
        w * (r00 + y.x * v.x - j.x * g.x - along),
        u * (r01 + y.x * v.y - j.x * g.y + r10 + y.y * v.x - j.y * g.x),
        u * (r02 + y.x * v.z - j.x * g.z + r20 + y.z * v.x - j.z * g.x),
        u * (k00 - j.x * v.x + h00 - v.x * g.x),
        u * (k01 - j.x * v.y + h10 - v.y * g.x),
        u * (k02 - j.x * v.z + h20 - v.z * g.x),
        w * (r11 + y.y * v.y - j.y * g.y - along),
        u * (r12 + y.y * v.z - j.y * g.z + r21 + y.z * v.y - j.z * g.y),
        u * (k10 - j.y * v.x + h01 - v.x * g.y),
        u * (k11 - j.y * v.y + h11 - v.y * g.y),
        u * (k12 - j.y * v.z + h21 - v.z * g.y),
        w * (r22 + y.z * v.z - j.z * g.z - along),
        u * (k20 - j.z * v.x + h02 - v.x * g.z),
        u * (k21 - j.z * v.y + h12 - v.y * g.z),
        u * (k22 - j.z * v.z + h22 - v.z * g.z),
        w * (c.xx - v.x * v.x),
        w * (c.xy - v.x * v.y),
        w * (c.xz - v.x * v.z),
        w * (c.yy - v.y * v.y),
        w * (c.yz - v.y * v.z),
        w * (c.zz - v.z * v.z),
    )  # fmt: skip


@fast
def likeness_of_colours(a, b, cap):
    """What the colours of two points make of their density, but for what any two make of it on average."""
    return density_of(F1, capped_distance(a.x, a.y, a.z, b.x, b.y, b.z, cap))


@fast
def no_likeness(a, b, cap):
    """The same where colours do not count."""
    return F1


@fast
def is_in_reach(own, k, boxes, tile, spread, cut):
    """Whether a pair of point k with the points of a box can lie within the cut, their variances times `spread`."""
    gap = F0
    for i in range(3):
        d = max(max(boxes[tile, i] - own[i, k], own[i, k] - boxes[tile, i + 3]), F0)
        gap += d * d
    return gap <= cut * (own[POINT - 1, k] + spread * boxes[tile, BOX_VARIANCE])


def _build(of_source, isotropic, coloured, stamp):
    """The kernel for points of the source, with all sums, or of the target, with the first CURVATURE of them.

    isotropic : of the matrices in the tiles.   coloured : whether colours count.
    """
    count_of_sums = SUMS if of_source else CURVATURE
    add, store = adder(count_of_sums, fast), column_storer(count_of_sums, fast)
    none = (F0,) * count_of_sums
    hue_of, likeness_of = (colour_of, likeness_of_colours) if coloured else (no_colour_of, no_likeness)

    @fast_kernel
    def score_sums(own, other, boxes, scale, spread, weights, shares, cut, own_hues, hues, cap, sums):
        """One block for each point k, whose threads take one point of a tile each, tile by tile.

        own : (POINT, K) float32.   other : (tiles, 4 + 1 or 6, TILE) the tiles of the other cloud, their matrices times
        `scale` its covariances; boxes : theirs, their variances times `spread`.   weights, shares : (tiles, TILE)
        float32 of the other's points.   own_hues, hues : (1, 3, K) and (tiles, 3, TILE) float32 colours of both, read
        where these count.   sums : (count_of_sums, K) float64, overwritten.
        """
        _ = stamp
        near = cuda.shared.array(TILE, int32)
        block = cuda.shared.array((count_of_sums, PADDED), float64)
        t = cuda.threadIdx.x
        k = cuda.blockIdx.x
        p = Point(own[0, k], own[1, k], own[2, k])
        q = Packed(own[3, k], own[4, k], own[5, k], own[6, k], own[7, k], own[8, k])
        own_hue = hue_of(own_hues, 0, k)
        count = other.shape[0]
        s = none
        for first in range(0, count, TILE):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t
            near[t] = tile < count and is_in_reach(own, k, boxes, tile, spread, cut)
            if cuda.syncthreads_or(near[t]) == 0:
                continue
            for i in range(TILE):
                if near[i] == 0:
                    continue
                tile = first + i
                x = point_of(other, tile, t)
                if isotropic:
                    m0 = isotropic_matrix_of(other, tile, t, scale)
                    m = Packed(m0, F0, F0, m0, F0, m0)
                else:
                    m = packed_matrix_of(other, tile, t, scale)
                weight, share = weights[tile, t], shares[tile, t]
                likeness = likeness_of(own_hue, hue_of(hues, tile, t), cap)
                if of_source:
                    s = add(s, curved(p, offset(p, x), m, q, cut, likeness, weight, share))
                else:
                    s = add(s, scored(x, offset(x, p), q, m, cut, likeness, weight, share))
            cuda.syncthreads()
        store(block, 0, t, s)
        cuda.syncthreads()
        reduce_tile(block, count_of_sums, t, k, sums)

    return score_sums


score_sums_of_source = _build(True, False, False, source_stamp())
score_sums_of_source_isotropic = _build(True, True, False, source_stamp())
score_sums_of_target = _build(False, False, False, source_stamp())
score_sums_of_target_isotropic = _build(False, True, False, source_stamp())
coloured_sums_of_source = _build(True, False, True, source_stamp())
coloured_sums_of_source_isotropic = _build(True, True, True, source_stamp())
coloured_sums_of_target = _build(False, False, True, source_stamp())
coloured_sums_of_target_isotropic = _build(False, True, True, source_stamp())
