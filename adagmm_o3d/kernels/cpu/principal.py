"""Principal variances and axes of many symmetric 3 x 3 matrices, and the scatter of neighbourhoods they come from.

Jacobi's rotations, one after the other, until nothing is left beside the diagonal: as exact as the library that NumPy
calls, and for matrices of this size three times as fast.
"""

import math

from numba import njit

from adagmm_o3d.kernels.cpu.compiling import EXACT_KERNEL_FLAGS, POINTWISE_FLAGS, source_stamp
from adagmm_o3d.kernels.jacobi import build

# What is left beside the diagonal, of it, squared, and the most sweeps to come there; four mostly do.
LEFT, SWEEPS = 1e-30, 16


_jacobi = build(njit(**POINTWISE_FLAGS))
sweep, ascending = _jacobi.sweep, _jacobi.ascending


def _build(stamp):
    """The kernels that are called from Python; `stamp` keeps their cache fresh."""

    @njit(**EXACT_KERNEL_FLAGS)
    def principal_axes(matrices, variances, axes):
        """`variances` (n, 3) and the columns of `axes` (n, 3, 3) receive the eigenvalues, ascending, and eigenvectors
        of (n, 3, 3) symmetric matrices, of which the upper triangle is read."""
        _ = stamp
        for n in range(matrices.shape[0]):
            m = matrices[n]
            largest = max(abs(m[0, 0]), abs(m[1, 1]), abs(m[2, 2]), abs(m[0, 1]), abs(m[0, 2]), abs(m[1, 2]))
            # Squares of numbers of any size must neither overflow nor vanish; a power of two costs no digit.
            unit = math.ldexp(1.0, math.frexp(largest)[1] - 1)
            xx, xy, xz = m[0, 0] / unit, m[0, 1] / unit, m[0, 2] / unit
            yy, yz, zz = m[1, 1] / unit, m[1, 2] / unit, m[2, 2] / unit
            x0, x1, x2, y0, y1, y2, z0, z1, z2 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
            for _sweep in range(SWEEPS):
                if not xy * xy + xz * xz + yz * yz > LEFT * (xx * xx + yy * yy + zz * zz):
                    break
                xx, xy, xz, yy, yz, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2 = sweep(
                    xx, xy, xz, yy, yz, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2
                )
            xx, yy, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2 = ascending(xx, yy, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2)
            variances[n, 0], variances[n, 1], variances[n, 2] = xx * unit, yy * unit, zz * unit
            axes[n, 0, 0], axes[n, 1, 0], axes[n, 2, 0] = x0, x1, x2
            axes[n, 0, 1], axes[n, 1, 1], axes[n, 2, 1] = y0, y1, y2
            axes[n, 0, 2], axes[n, 1, 2], axes[n, 2, 2] = z0, z1, z2

    @njit(**EXACT_KERNEL_FLAGS)
    def scatter_among(points, weights, rows, squares, reach_sq, scatters, counts):
        """`scatters` (n, D, D) receive the weighted covariances of (N, D) points with (N,) weights, each of those that
        (n, k) `rows` names and whose `squares` (n, k) are within `reach_sq`; `counts` (n,) how many these are."""
        _ = stamp
        planar = points.shape[1] == 2
        for n in range(rows.shape[0]):
            x = y = z = total = 0.0
            count = 0
            for k in range(rows.shape[1]):
                if squares[n, k] <= reach_sq:
                    i = rows[n, k]
                    weight = weights[i]
                    total += weight
                    count += 1
                    x += weight * points[i, 0]
                    y += weight * points[i, 1]
                    z += 0.0 if planar else weight * points[i, 2]
            counts[n] = count
            total = max(total, 1e-300)
            x, y, z = x / total, y / total, z / total
            xx = xy = xz = yy = yz = zz = 0.0
            for k in range(rows.shape[1]):
                if squares[n, k] <= reach_sq:
                    i = rows[n, k]
                    share = weights[i] / total
                    dx, dy, dz = points[i, 0] - x, points[i, 1] - y, 0.0 if planar else points[i, 2] - z
                    sx, sy = share * dx, share * dy
                    xx += sx * dx
                    xy += sx * dy
                    xz += sx * dz
                    yy += sy * dy
                    yz += sy * dz
                    zz += share * dz * dz
            scatter = scatters[n]
            scatter[0, 0], scatter[0, 1], scatter[1, 0], scatter[1, 1] = xx, xy, xy, yy
            if not planar:
                scatter[0, 2], scatter[1, 2], scatter[2, 0], scatter[2, 1], scatter[2, 2] = xz, yz, xz, yz, zz

    return principal_axes, scatter_among


principal_axes, scatter_among = _build(source_stamp())
