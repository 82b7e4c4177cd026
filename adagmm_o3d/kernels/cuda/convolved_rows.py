"""The E-step on convolved Gaussians on the GPU: the sums of every source point, as in `kernels.cpu.convolved_pass`."""

import math

from numba import float32, int32

from adagmm_o3d.kernels.cuda.front_end import (
    F0,
    F1,
    TILE,
    cuda,
    fast,
    fast_kernel,
    formulas,
    source_stamp,
)
from adagmm_o3d.kernels.cuda.tiles import is_near, isotropic_matrix_of, packed_matrix_of, point_of
from adagmm_o3d.kernels.layout import FACTOR, HUE, ISOTROPIC_FACTOR, ISOTROPIC_HUE, MATRIX, SHARE, X

convolved_full, convolved_isotropic = formulas.convolved_full, formulas.convolved_isotropic
capped_distance, density_of = formulas.capped_distance, formulas.density_of

# Sums of a source point: layout.WEIGHT to PULL, then the density.
ROWS = 12
ROW_DENSITY = 11
# Tiles summed in float32 before float64 takes over.
FLUSH = 4
NONE = (F0,) * ROWS
NOTHING = (0.0,) * ROWS


@fast
def pair_anisotropic(x, j, y, b, unlike, s):
    """The sums `s` of the source point y (3) with the packed covariance b (6) and target point j of the tile `x` added;
    `unlike` is the capped distance of their colours, or zero."""
    dx = y[0] - x[j, X]
    dy = y[1] - x[j, X + 1]
    dz = y[2] - x[j, X + 2]
    height, inverse, q, vx, vy, vz, c0, c1, c2, c3, c4, c5 = convolved_full(
        x[j, SHARE],
        dx,
        dy,
        dz,
        x[j, MATRIX] + b[0],
        x[j, MATRIX + 1] + b[1],
        x[j, MATRIX + 2] + b[2],
        x[j, MATRIX + 3] + b[3],
        x[j, MATRIX + 4] + b[4],
        x[j, MATRIX + 5] + b[5],
    )
    g = density_of(height, q + unlike)
    c = g * x[j, FACTOR]
    k = c * inverse
    return (
        s[0] + c,
        s[1] + c * q,
        s[2] + k * c0,
        s[3] + k * c1,
        s[4] + k * c2,
        s[5] + k * c3,
        s[6] + k * c4,
        s[7] + k * c5,
        s[8] + k * vx,
        s[9] + k * vy,
        s[10] + k * vz,
        s[11] + g,
    )


@fast
def pair_isotropic(x, j, y, b, planar, unlike, s):
    """The same where every covariance is a multiple of the identity."""
    dx = y[0] - x[j, X]
    dy = y[1] - x[j, X + 1]
    dz = y[2] - x[j, X + 2]
    height, precision, q = convolved_isotropic(x[j, SHARE], dx, dy, dz, x[j, MATRIX] + b, planar)
    g = density_of(height, q + unlike)
    c = g * x[j, ISOTROPIC_FACTOR]
    k = c * precision
    p = s[2] + k
    return (s[0] + c, s[1] + c * q, p, F0, F0, p, F0, p, s[8] + k * dx, s[9] + k * dy, s[10] + k * dz, s[11] + g)


@fast
def unlike_at(x, j, hue, h0, h1, h2, cap):
    """The capped distance of a colour to that of point j of the tile `x`, whose columns begin at `hue`."""
    return capped_distance(h0, h1, h2, x[j, hue], x[j, hue + 1], x[j, hue + 2], cap)


@fast
def added(total, s):
    """The float64 sums `total` with the float32 sums `s` added."""
    return (
        total[0] + s[0],
        total[1] + s[1],
        total[2] + s[2],
        total[3] + s[3],
        total[4] + s[4],
        total[5] + s[5],
        total[6] + s[6],
        total[7] + s[7],
        total[8] + s[8],
        total[9] + s[9],
        total[10] + s[10],
        total[11] + s[11],
    )


@fast
def column_factor(density, uniform, mutuality):
    """(uniform / (density + uniform))**mutuality: what a target point's posterior does to the weights of its pairs."""
    return math.exp2(mutuality * math.log2(uniform / (density + uniform)))


def _build(isotropic, coloured, stamp):
    """The kernel for one kind of matrices, with colours or without; `stamp` keeps its cache fresh."""
    matrix_of = isotropic_matrix_of if isotropic else packed_matrix_of
    factor, hue = (ISOTROPIC_FACTOR, ISOTROPIC_HUE) if isotropic else (FACTOR, HUE)
    # Whole 16-byte words, which the compiler then loads at once.
    width = 4 * -(-(hue + (3 if coloured else 0)) // 4)

    @fast_kernel
    def convolved_rows(
        moved, moved_boxes, target, target_boxes, sigma, planar, columns, uniform, mutuality,
        hues, target_hues, cap, rows,
    ):  # fmt: skip
        """One block for each source tile (x) and share of the target tiles (y), one thread for each source point.

        hues, target_hues : (tiles, 3, TILE) float32 colours, see `kernels.cpu.convolved_rows`, read where these count.
        columns : (target tiles, TILE) float32 densities at the target points, read where mutuality > 0.
        rows : (shares, ROWS or more, source tiles x TILE) float64, overwritten.
        """
        _ = stamp
        x = cuda.shared.array((TILE, width), float32)
        near = cuda.shared.array(TILE, int32)
        t = cuda.threadIdx.x
        own = cuda.blockIdx.x
        share = cuda.blockIdx.y
        shares = cuda.gridDim.y
        count = target.shape[0]
        y, b = point_of(moved, own, t), matrix_of(moved, own, t, F1)
        if coloured:
            h0, h1, h2 = hues[own, 0, t], hues[own, 1, t], hues[own, 2, t]
        else:
            h0 = h1 = h2 = F0
        unlike = F0
        total = NOTHING
        s = NONE
        pending = 0
        for first in range(share, count, TILE * shares):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t * shares
            found = 0
            if tile < count and is_near(True, moved_boxes, own, sigma, target_boxes, tile, sigma):
                found = 1
            near[t] = found
            if cuda.syncthreads_or(found) == 0:
                continue
            for k in range(TILE):
                if near[k] == 0:
                    continue
                tile = first + k * shares
                for i in range(factor):
                    x[t, i] = target[tile, i, t] * (sigma if i >= MATRIX else F1)
                x[t, factor] = column_factor(columns[tile, t], uniform, mutuality) if mutuality > F0 else F1
                if coloured:
                    for i in range(3):
                        x[t, hue + i] = target_hues[tile, i, t]
                cuda.syncthreads()
                for j in range(0, TILE, 4):
                    if isotropic:
                        unlike = unlike_at(x, j, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_isotropic(x, j, y, b, planar, unlike, s)
                        unlike = unlike_at(x, j + 1, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_isotropic(x, j + 1, y, b, planar, unlike, s)
                        unlike = unlike_at(x, j + 2, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_isotropic(x, j + 2, y, b, planar, unlike, s)
                        unlike = unlike_at(x, j + 3, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_isotropic(x, j + 3, y, b, planar, unlike, s)
                    else:
                        unlike = unlike_at(x, j, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_anisotropic(x, j, y, b, unlike, s)
                        unlike = unlike_at(x, j + 1, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_anisotropic(x, j + 1, y, b, unlike, s)
                        unlike = unlike_at(x, j + 2, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_anisotropic(x, j + 2, y, b, unlike, s)
                        unlike = unlike_at(x, j + 3, hue, h0, h1, h2, cap) if coloured else F0
                        s = pair_anisotropic(x, j + 3, y, b, unlike, s)
                pending += 1
                if pending == FLUSH:
                    total = added(total, s)
                    s = NONE
                    pending = 0
                cuda.syncthreads()
            cuda.syncthreads()
        total = added(total, s)
        m = own * TILE + t
        rows[share, 0, m] = total[0]
        rows[share, 1, m] = total[1]
        rows[share, 2, m] = total[2]
        rows[share, 3, m] = total[3]
        rows[share, 4, m] = total[4]
        rows[share, 5, m] = total[5]
        rows[share, 6, m] = total[6]
        rows[share, 7, m] = total[7]
        rows[share, 8, m] = total[8]
        rows[share, 9, m] = total[9]
        rows[share, 10, m] = total[10]
        rows[share, 11, m] = total[11]

    return convolved_rows


convolved_rows_isotropic = _build(True, False, source_stamp())
convolved_rows_anisotropic = _build(False, False, source_stamp())
coloured_rows_isotropic = _build(True, True, source_stamp())
coloured_rows_anisotropic = _build(False, True, source_stamp())
