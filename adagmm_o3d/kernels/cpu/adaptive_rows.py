"""The paper's E-step: every pair weighted by both points' own Gaussians, and the sums that its M-step needs.

Every array is a structure of arrays (one row per component), so that the innermost loop, over target points, becomes
vector code. Pairs are evaluated in float32 and summed in float64.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.compiling import F0, F1, FLAGS, KERNEL_FLAGS, POINTWISE_FLAGS, formulas, source_stamp
from adagmm_o3d.kernels.cpu.culling import CLUSTER, CLUSTERS_PER_CHUNK, RUN, Box, cluster_box, largest, next_run
from adagmm_o3d.kernels.cpu.moving import move_symmetric
from adagmm_o3d.kernels.cpu.normal_equations import add_rows
from adagmm_o3d.kernels.cpu.row_sums import add_full, add_isotropic
from adagmm_o3d.kernels.layout import PRECISION, ROW_SUMS, TORQUE, WEIGHT

adaptive_full, adaptive_isotropic, dot = formulas.adaptive_full, formulas.adaptive_isotropic, formulas.dot


class AdaptiveSource(NamedTuple):
    """A source: points (3, M), precisions (1 or 6, M) packed, amplitudes, largest variances and bits (M,), see
    `culling.reach_sq`."""

    points: NDArray[np.float32]
    precisions: NDArray[np.float32]
    amplitudes: NDArray[np.float32]
    variances: NDArray[np.float32]
    bits: NDArray[np.float32]


class AdaptiveTarget(NamedTuple):
    """A target: points (3, N), precisions (1 or 6, N) packed at its σ, amplitudes (N,)."""

    points: NDArray[np.float32]
    precisions: NDArray[np.float32]
    amplitudes: NDArray[np.float32]


@njit(**FLAGS)
def rows_full(target, i, j, count, y, turned, rows):
    """Add to `rows` (layout.ROW_SUMS, points) the pairs of `count` source points `y` (3, points), their precisions
    `turned` (points, 6), with the target points i..j."""
    x, a, amplitudes = target
    x0, x1, x2, amplitude = x[0, i:j], x[1, i:j], x[2, i:j], amplitudes[i:j]
    a0, a1, a2, a3, a4, a5 = a[0, i:j], a[1, i:j], a[2, i:j], a[3, i:j], a[4, i:j], a[5, i:j]
    for k in range(count):
        y0, y1, y2 = y[0, k], y[1, k], y[2, k]
        b0, b1, b2, b3, b4, b5 = turned[k, 0], turned[k, 1], turned[k, 2], turned[k, 3], turned[k, 4], turned[k, 5]
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
        for n in range(x0.shape[0]):
            dx = y0 - x0[n]
            dy = y1 - x1[n]
            dz = y2 - x2[n]
            c, q, ux, uy, uz, tx, ty, tz = adaptive_full(
                amplitude[n], dx, dy, dz, a0[n], a1[n], a2[n], a3[n], a4[n], a5[n], b0, b1, b2, b3, b4, b5
            )
            w += c
            e += c * q
            p0 += c * a0[n]
            p1 += c * a1[n]
            p2 += c * a2[n]
            p3 += c * a3[n]
            p4 += c * a4[n]
            p5 += c * a5[n]
            u0 += c * ux
            u1 += c * uy
            u2 += c * uz
            t0 += c * tx
            t1 += c * ty
            t2 += c * tz
        add_full(rows, k, w, e, p0, p1, p2, p3, p4, p5, u0, u1, u2)
        rows[TORQUE, k] += t0
        rows[TORQUE + 1, k] += t1
        rows[TORQUE + 2, k] += t2


@njit(**FLAGS)
def rows_isotropic(target, i, j, count, y, turned, weights, rows):
    """The same where every precision is a multiple of the identity: nothing turns, three directions share one sum.

    `weights` is room for those of so many pairs: the constants of the exponentials and the sums would not fit into the
    registers together.
    """
    x, precisions, amplitudes = target
    x0, x1, x2, a, amplitude = x[0, i:j], x[1, i:j], x[2, i:j], precisions[0, i:j], amplitudes[i:j]
    for k in range(count):
        y0, y1, y2, b = y[0, k], y[1, k], y[2, k], turned[k, 0]
        for n in range(x0.shape[0]):
            dx = y0 - x0[n]
            dy = y1 - x1[n]
            dz = y2 - x2[n]
            weights[n] = adaptive_isotropic(amplitude[n], dot(dx, dy, dz, dx, dy, dz), a[n], b)
        w = F0
        e = F0
        p = F0
        u0 = F0
        u1 = F0
        u2 = F0
        for n in range(x0.shape[0]):
            dx = y0 - x0[n]
            dy = y1 - x1[n]
            dz = y2 - x2[n]
            c = weights[n]
            f = c * (a[n] + b)
            w += c
            e += f * dot(dx, dy, dz, dx, dy, dz)
            p += c * a[n]
            u0 += f * dx
            u1 += f * dy
            u2 += f * dz
        add_isotropic(rows, k, w, e, p, u0, u1, u2)


@njit(**POINTWISE_FLAGS)
def finish_rows(rows, m0, m1, amplitudes, turned, row_weights):
    """Make Σ C (A + B) of source points m0..m1 out of Σ C A, B their own precisions, and keep what each weighs."""
    for m in range(m0, m1):
        k = m - m0
        row_weights[m] = amplitudes[m] * rows[WEIGHT, k]
        for i in range(6):
            rows[PRECISION + i, k] += rows[WEIGHT, k] * turned[k, i]


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def adaptive_sums(pose, sigmas, source, target, tiles, isotropic, partials, row_weights):
        """All pairs of an `AdaptiveSource` at `pose` (12,) with an `AdaptiveTarget`; `sigmas` (2,) are those of either.

        partials : (chunks, TOTAL_SUMS) and row_weights : (M,), overwritten.
        """
        _ = stamp
        points, precisions, amplitudes, variances, bits = source
        m_all, n_all = points.shape[1], target.points.shape[1]
        count = tiles[0].shape[1]
        for chunk in prange(partials.shape[0]):
            total = partials[chunk]
            total[:] = 0.0
            y = np.empty((3, CLUSTER), np.float32)
            lo = np.empty(3, np.float32)
            hi = np.empty(3, np.float32)
            turned = np.empty((CLUSTER, 6), np.float32)
            weights = np.empty(RUN, np.float32)
            for cluster in range(chunk * CLUSTERS_PER_CHUNK, (chunk + 1) * CLUSTERS_PER_CHUNK):
                m0 = cluster * CLUSTER
                m1 = min(m_all, m0 + CLUSTER)
                if m0 >= m1:
                    break
                cluster_box(pose, points, m0, m1, y, lo, hi)
                box = Box(lo, hi, sigmas[0] * largest(variances, m0, m1), largest(bits, m0, m1))
                rows = np.zeros((ROW_SUMS, CLUSTER), np.float64)
                for m in range(m0, m1):
                    move_symmetric(pose, precisions, F1 / sigmas[0], isotropic, m, turned, m - m0)
                tile = 0
                while tile < count:
                    i, j, tile = next_run(tile, box, sigmas[1], tiles, n_all)
                    if i >= j:
                        break
                    if isotropic:
                        rows_isotropic(target, i, j, m1 - m0, y, turned, weights, rows)
                    else:
                        rows_full(target, i, j, m1 - m0, y, turned, rows)
                finish_rows(rows, m0, m1, amplitudes, turned, row_weights)
                add_rows(rows, m1 - m0, amplitudes[m0:m1], y, total)

    return adaptive_sums


adaptive_sums = _build(source_stamp())
