"""The E-step on convolved Gaussians: a pair weighs what the density of x - y is at zero, N(d; 0, Σx + R Σy Rᵀ).

Unlike the paper's weights these are shares of a likelihood, so a source point's weights can be divided by the density
of the target mixture plus a uniform one (the points without a partner): the posterior of EM. The same is done for the
target points by a factor for each, from the column sums of the pass before.
"""

import math

import numpy as np
from numba import njit, prange

from .compiling import F0, F1, FLAGS, KERNEL_FLAGS, formulas, source_stamp
from .culling import CLUSTER, cluster_box, largest, next_run
from .exp2 import exp2_float32
from .layout import DENSITY, ROW_SUMS, TOTAL_LIKELIHOOD, TOTAL_MATCHED
from .normal_equations import add_row
from .turning import turn_symmetric

dot = formulas.dot
adjugate, symmetric_product = formulas.adjugate, formulas.symmetric_product


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


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def convolution_sums(
        pose, sigmas, source, target, tiles, isotropic, planar, uniform, mutuality, bands, columns, partials, densities
    ):  # fmt: skip
        _ = stamp
        points, covariances, weights, weights32, variances, bits = source
        x, a, share, factor = target
        m_all = points.shape[1]
        n_all = x.shape[1]
        count = tiles[0].shape[1]
        clusters = (m_all + CLUSTER - 1) // CLUSTER
        still = np.zeros(6, np.float32)
        for band in prange(bands):
            total = partials[band]
            total[:] = 0.0
            column = columns[band]
            column[:] = F0
            y = np.empty((3, CLUSTER), np.float32)
            lo = np.empty(3, np.float32)
            hi = np.empty(3, np.float32)
            turned = np.empty((CLUSTER, 6), np.float32)
            for cluster in range(band * clusters // bands, (band + 1) * clusters // bands):
                m0 = cluster * CLUSTER
                m1 = min(m_all, m0 + CLUSTER)
                cluster_box(pose, points, m0, m1, y, lo, hi)
                box = (lo, hi, sigmas[0] * largest(variances, m0, m1), largest(bits, m0, m1))
                rows = np.zeros((CLUSTER, ROW_SUMS), np.float64)
                for m in range(m0, m1):
                    turn_symmetric(pose, covariances, sigmas[0], isotropic, m, turned[m - m0])
                    if planar:
                        turned[m - m0, 5] = F1
                tile = 0
                while tile < count:
                    i, j, tile = next_run(tile, box, sigmas[1], tiles, True, n_all)
                    if i >= j:
                        break
                    for m in range(m0, m1):
                        k = m - m0
                        b = turned[k]
                        own = weights32[m]
                        if isotropic:
                            row_convolved_isotropic(
                                x[0, i:j], x[1, i:j], x[2, i:j], a[0, i:j], share[i:j], factor[i:j], planar,
                                own, y[0, k], y[1, k], y[2, k], b[0], column[i:j], rows[k],
                            )  # fmt: skip
                        else:
                            row_convolved(
                                x[0, i:j], x[1, i:j], x[2, i:j],
                                a[0, i:j], a[1, i:j], a[2, i:j], a[3, i:j], a[4, i:j], a[5, i:j],
                                share[i:j], factor[i:j],
                                own, y[0, k], y[1, k], y[2, k], b[0], b[1], b[2], b[3], b[4], b[5],
                                column[i:j], rows[k],
                            )  # fmt: skip
                for m in range(m0, m1):
                    k = m - m0
                    density = rows[k, DENSITY]
                    densities[m] = density
                    posterior = 1.0 / (density + uniform)
                    total[TOTAL_LIKELIHOOD] += weights[m] * math.log1p(density / uniform)
                    total[TOTAL_MATCHED] += weights[m] * density * posterior
                    scale = weights[m] * posterior ** (1.0 - mutuality) * uniform**-mutuality
                    add_row(rows[k], scale, y[0, k], y[1, k], y[2, k], still, total)

    return convolution_sums


convolution_sums = _build(source_stamp())
