"""The paper's E-step: every pair weighted by both points' own Gaussians, and the sums that its M-step needs.

Every array is a structure of arrays (one row per component), so that the innermost loop, over target points, becomes
vector code. Pairs are evaluated in float32 and summed in float64.
"""

import numpy as np
from numba import njit, prange

from .compiling import F0, F1, FLAGS, KERNEL_FLAGS, formulas, source_stamp
from .culling import CLUSTER, CLUSTERS_PER_CHUNK, cluster_box, largest, next_run
from .exp2 import exp2_float32
from .layout import ROW_SUMS, WEIGHT
from .normal_equations import add_row
from .turning import turn_symmetric

symmetric_product, dot, cross = formulas.symmetric_product, formulas.dot, formulas.cross


@njit(**FLAGS)
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


@njit(**FLAGS)
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


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def adaptive_sums(pose, sigmas, source, target, tiles, isotropic, chunk_lo, chunk_hi, partials, row_weights):
        _ = stamp
        points, precisions, amplitudes, variances, bits = source
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
                cluster_box(pose, points, m0, m1, y, lo, hi)
                box = (lo, hi, sigmas[0] * largest(variances, m0, m1), largest(bits, m0, m1))
                rows = np.zeros((CLUSTER, ROW_SUMS), np.float64)
                for m in range(m0, m1):
                    turn_symmetric(pose, precisions, F1 / sigmas[0], isotropic, m, turned, m - m0)
                tile = 0
                while tile < count:
                    i, j, tile = next_run(tile, box, sigmas[1], tiles, n_all)
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
                                a[0, i:j], a[1, i:j], a[2, i:j], a[3, i:j], a[4, i:j], a[5, i:j],
                                target_amplitudes[i:j],
                                y[0, k], y[1, k], y[2, k], b[0], b[1], b[2], b[3], b[4], b[5], rows[k],
                            )  # fmt: skip
                for m in range(m0, m1):
                    k = m - m0
                    row_weights[m] = amplitudes[m] * rows[k, WEIGHT]
                    add_row(rows, k, amplitudes[m], y[0, k], y[1, k], y[2, k], turned, total)

    return adaptive_sums


adaptive_sums = _build(source_stamp())
