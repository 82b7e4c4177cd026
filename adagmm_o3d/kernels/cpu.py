"""The loops over all pairs on the CPU: E-step with the sums of the M-step, and nearest distances.

Every array is a structure of arrays (one row per component), so that the innermost loop, over target points, becomes
vector code. Pairs are evaluated in float32 and summed in float64. The target is cut into tiles of `TILE` points with a
bounding box each, the source into clusters of `CLUSTER` points; a tile out of a cluster's reach is skipped whole.
Source clusters are handed out in chunks whose partial sums are added in order: the same bits for any thread count.
"""

import hashlib
from pathlib import Path

import numpy as np
from numba import njit, prange

from . import gaussian
from .exp2 import exp2_float32
from .layout import ENERGY, GRADIENT, HESSIAN, PRECISION, PULL, ROW_SUMS, TOTAL_ENERGY, TOTAL_SUMS, TOTAL_WEIGHT
from .layout import TURN, WEIGHT

TILE = 64
CLUSTER = 8
CLUSTERS_PER_CHUNK = 4
GROUP = 16  # tiles skipped together
RUN = 1024  # target points summed in float32 before float64 takes over
FAST = {"reassoc", "contract", "arcp", "nsz"}
F0, F1 = np.float32(0.0), np.float32(1.0)

_formulas = gaussian.build(njit(fastmath=FAST, error_model="numpy"))
symmetric_product, dot, cross = _formulas.symmetric_product, _formulas.dot, _formulas.cross
rotate_point, rotate_symmetric = _formulas.rotate_point, _formulas.rotate_symmetric


def _source_stamp() -> int:
    files = sorted(Path(__file__).parent.glob("*.py"))
    return int(hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:15], 16)


@njit(fastmath=FAST, error_model="numpy")
def row_sums_anisotropic(x0, x1, x2, a0, a1, a2, a3, a4, a5, amplitude, y0, y1, y2, b0, b1, b2, b3, b4, b5, row):
    """Add to `row` (layout.ROW_SUMS) the pairs of one source point with a run of target points."""
    w = F0
    e = F0
    p0 = F0
    p1 = F0
    p2 = F0
    p3 = F0
    p4 = F0
    p5 = F0
    u0 = F0
    u1 = F0
    u2 = F0
    t0 = F0
    t1 = F0
    t2 = F0
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        ax, ay, az = symmetric_product(a0[j], a1[j], a2[j], a3[j], a4[j], a5[j], dx, dy, dz)
        bx, by, bz = symmetric_product(b0, b1, b2, b3, b4, b5, dx, dy, dz)
        qa = dot(dx, dy, dz, ax, ay, az)
        qb = dot(dx, dy, dz, bx, by, bz)
        c = amplitude[j] * (exp2_float32(-qa) + exp2_float32(-qb))
        tx, ty, tz = cross(dx, dy, dz, bx, by, bz)
        w += c
        e += c * (qa + qb)
        p0 += c * a0[j]
        p1 += c * a1[j]
        p2 += c * a2[j]
        p3 += c * a3[j]
        p4 += c * a4[j]
        p5 += c * a5[j]
        u0 += c * (ax + bx)
        u1 += c * (ay + by)
        u2 += c * (az + bz)
        t0 += c * tx
        t1 += c * ty
        t2 += c * tz
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
    row[11] += t0
    row[12] += t1
    row[13] += t2


@njit(fastmath=FAST, error_model="numpy")
def row_sums_isotropic(x0, x1, x2, a, amplitude, y0, y1, y2, b, row):
    """The same where every precision is a multiple of the identity: nothing turns, three directions share one sum."""
    w = F0
    e = F0
    p = F0
    u0 = F0
    u1 = F0
    u2 = F0
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        d2 = dot(dx, dy, dz, dx, dy, dz)
        c = amplitude[j] * (exp2_float32(-a[j] * d2) + exp2_float32(-b * d2))
        k = c * (a[j] + b)
        w += c
        e += k * d2
        p += c * a[j]
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


@njit(error_model="numpy")
def gap_sq(lo, hi, box_lo, box_hi, i):
    """Squared distance between two axis-aligned boxes; 0 where they meet."""
    gap = 0.0
    for k in range(3):
        d = max(box_lo[k, i] - hi[k], lo[k] - box_hi[k, i], 0.0)
        gap += d * d
    return gap


@njit(fastmath=FAST | {"nnan"}, error_model="numpy")
def row_nearest_sq(x0, x1, x2, y0, y1, y2):
    """Squared distance from one source point to the nearest of a run of target points."""
    best = np.float32(np.inf)
    for j in range(x0.shape[0]):
        dx = y0 - x0[j]
        dy = y1 - x1[j]
        dz = y2 - x2[j]
        best = min(best, dot(dx, dy, dz, dx, dy, dz))
    return best


@njit(error_model="numpy")
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


@njit(error_model="numpy")
def next_run(tile, lo, hi, reach_sq, target_sigma, tiles_of_target, n):
    """The next run of target points within reach of the box (lo, hi), from `tile` on: (first, past the last, next tile).

    Groups of GROUP tiles are skipped whole. A run ends at the first tile out of reach or after RUN points.
    """
    box_lo, box_hi, box_reach_sq, group_lo, group_hi, group_reach_sq = tiles_of_target
    tiles = box_lo.shape[1]
    first = -1
    while tile < tiles:
        if first < 0 and tile % GROUP == 0:
            g = tile // GROUP
            if gap_sq(lo, hi, group_lo, group_hi, g) > max(reach_sq, target_sigma * group_reach_sq[g]):
                tile += GROUP
                continue
        if gap_sq(lo, hi, box_lo, box_hi, tile) > max(reach_sq, target_sigma * box_reach_sq[tile]):
            if first >= 0:
                break
        elif first < 0:
            first = tile * TILE
        tile += 1
        if first >= 0 and tile * TILE - first >= RUN:
            break
    if first < 0:
        return n, n, tiles
    return first, min(n, tile * TILE), tile


@njit(fastmath=FAST, error_model="numpy")
def cluster_box(pose, points, reaches_sq, m0, m1, y, lo, hi):
    """Move source points m0..m1 into `y`, their box into `lo`, `hi`; returns the largest squared reach among them."""
    lo[:] = np.inf
    hi[:] = -np.inf
    reach_sq = F0
    for m in range(m0, m1):
        k = m - m0
        y[0, k], y[1, k], y[2, k] = rotate_point(pose, points[0, m], points[1, m], points[2, m])
        for i in range(3):
            lo[i] = min(lo[i], y[i, k])
            hi[i] = max(hi[i], y[i, k])
        reach_sq = max(reach_sq, reaches_sq[m])
    return reach_sq


@njit(fastmath=FAST, error_model="numpy")
def turn_precision(pose, precisions, scale, isotropic, m, turned):
    """R B Rᵀ of source point m times `scale`, packed, into `turned`."""
    if isotropic:
        turned[:] = F0
        turned[0] = precisions[0, m] * scale
        turned[3] = turned[0]
        turned[5] = turned[0]
    else:
        turned[0], turned[1], turned[2], turned[3], turned[4], turned[5] = rotate_symmetric(
            pose,
            precisions[0, m] * scale,
            precisions[1, m] * scale,
            precisions[2, m] * scale,
            precisions[3, m] * scale,
            precisions[4, m] * scale,
            precisions[5, m] * scale,
        )


@njit(error_model="numpy")
def add_row(row, amplitude, y0, y1, y2, b, total):
    """Turn the sums of one source point into its share of the M-step's 6x6 system (layout.TOTAL_SUMS), float64."""
    w = amplitude * row[WEIGHT]
    p0 = amplitude * row[PRECISION] + w * b[0]
    p1 = amplitude * row[PRECISION + 1] + w * b[1]
    p2 = amplitude * row[PRECISION + 2] + w * b[2]
    p3 = amplitude * row[PRECISION + 3] + w * b[3]
    p4 = amplitude * row[PRECISION + 4] + w * b[4]
    p5 = amplitude * row[PRECISION + 5] + w * b[5]
    u0 = amplitude * row[PULL]
    u1 = amplitude * row[PULL + 1]
    u2 = amplitude * row[PULL + 2]
    # [y]x P, row by row; the columns of P are (p0 p1 p2), (p1 p3 p4), (p2 p4 p5).
    k00, k10, k20 = cross(y0, y1, y2, p0, p1, p2)
    k01, k11, k21 = cross(y0, y1, y2, p1, p3, p4)
    k02, k12, k22 = cross(y0, y1, y2, p2, p4, p5)
    h = HESSIAN
    total[h] += k02 * y1 - k01 * y2
    total[h + 1] += k00 * y2 - k02 * y0
    total[h + 2] += k01 * y0 - k00 * y1
    total[h + 3] += k00
    total[h + 4] += k01
    total[h + 5] += k02
    total[h + 6] += k10 * y2 - k12 * y0
    total[h + 7] += k11 * y0 - k10 * y1
    total[h + 8] += k10
    total[h + 9] += k11
    total[h + 10] += k12
    total[h + 11] += k21 * y0 - k20 * y1
    total[h + 12] += k20
    total[h + 13] += k21
    total[h + 14] += k22
    total[h + 15] += p0
    total[h + 16] += p1
    total[h + 17] += p2
    total[h + 18] += p3
    total[h + 19] += p4
    total[h + 20] += p5
    g0, g1, g2 = cross(y0, y1, y2, u0, u1, u2)
    g = GRADIENT
    total[g] += g0 - amplitude * row[TURN]
    total[g + 1] += g1 - amplitude * row[TURN + 1]
    total[g + 2] += g2 - amplitude * row[TURN + 2]
    total[g + 3] += u0
    total[g + 4] += u1
    total[g + 5] += u2
    total[TOTAL_WEIGHT] += w
    total[TOTAL_ENERGY] += amplitude * row[ENERGY]


def _build(stamp):
    """The kernels that are called from Python.

    `stamp` is a hash of every file of this folder. As a free variable it is part of Numba's cache key: an edit anywhere
    here, also in a file that a kernel only calls into, compiles anew.
    """

    @njit(parallel=True, cache=True, nogil=True, fastmath=FAST, error_model="numpy")
    def pair_sums(pose, sigmas, source, target, tiles, isotropic, chunk_lo, chunk_hi, partials, row_weights):
        _ = stamp
        points, precisions, amplitudes, reaches_sq = source
        x, a, target_amplitudes = target
        m_all = points.shape[1]
        n_all = x.shape[1]
        count = tiles[0].shape[1]
        for chunk in prange(chunk_lo, chunk_hi):
            total = partials[chunk]
            total[:] = 0.0
            y = np.empty((3, CLUSTER), np.float32)
            lo = np.empty(3, np.float32)
            hi = np.empty(3, np.float32)
            turned = np.empty((CLUSTER, 6), np.float32)
            for cluster in range(chunk * CLUSTERS_PER_CHUNK, (chunk + 1) * CLUSTERS_PER_CHUNK):
                m0 = cluster * CLUSTER
                m1 = min(m_all, m0 + CLUSTER)
                if m0 >= m1:
                    break
                reach_sq = sigmas[0] * cluster_box(pose, points, reaches_sq, m0, m1, y, lo, hi)
                rows = np.zeros((CLUSTER, ROW_SUMS), np.float64)
                for m in range(m0, m1):
                    turn_precision(pose, precisions, F1 / sigmas[0], isotropic, m, turned[m - m0])
                tile = 0
                while tile < count:
                    i, j, tile = next_run(tile, lo, hi, reach_sq, sigmas[1], tiles, n_all)
                    if i >= j:
                        break
                    for m in range(m0, m1):
                        k = m - m0
                        b = turned[k]
                        if isotropic:
                            row_sums_isotropic(
                                x[0, i:j], x[1, i:j], x[2, i:j], a[0, i:j], target_amplitudes[i:j],
                                y[0, k], y[1, k], y[2, k], b[0], rows[k],
                            )  # fmt: skip
                        else:
                            row_sums_anisotropic(
                                x[0, i:j], x[1, i:j], x[2, i:j],
                                a[0, i:j], a[1, i:j], a[2, i:j], a[3, i:j], a[4, i:j], a[5, i:j], target_amplitudes[i:j],
                                y[0, k], y[1, k], y[2, k], b[0], b[1], b[2], b[3], b[4], b[5], rows[k],
                            )  # fmt: skip
                for m in range(m0, m1):
                    k = m - m0
                    row = rows[k]
                    row_weights[m] = amplitudes[m] * row[WEIGHT]
                    add_row(row, amplitudes[m], y[0, k], y[1, k], y[2, k], turned[k], total)

    @njit(parallel=True, cache=True, nogil=True, fastmath=FAST, error_model="numpy")
    def nearest_sq(pose, points, no_reach, x, tiles_of_target, chunk_lo, chunk_hi, nearest):
        _ = stamp
        box_lo, box_hi, _, group_lo, group_hi, _ = tiles_of_target
        count = box_lo.shape[1]
        for chunk in prange(chunk_lo, chunk_hi):
            y = np.empty((3, CLUSTER), np.float32)
            lo = np.empty(3, np.float32)
            hi = np.empty(3, np.float32)
            for cluster in range(chunk * CLUSTERS_PER_CHUNK, (chunk + 1) * CLUSTERS_PER_CHUNK):
                m0 = cluster * CLUSTER
                m1 = min(points.shape[1], m0 + CLUSTER)
                if m0 >= m1:
                    break
                cluster_box(pose, points, no_reach, m0, m1, y, lo, hi)
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

    return pair_sums, nearest_sq


pair_sums, nearest_sq = _build(_source_stamp())
