"""The E-step on convolved Gaussians on the GPU: the sums of every source point, as in `kernels.cpu.convolved_pass`."""

import math

from numba import float32, int32

from adagmm_o3d.kernels.cuda.front_end import F0, F1, TILE, cuda, fast, fast_kernel, formulas, source_stamp
from adagmm_o3d.kernels.cuda.shared_tile import (
    alike,
    colour_of,
    combined,
    no_colour_of,
    offset,
    packed_at,
    point_at,
    unlike_from,
)
from adagmm_o3d.kernels.cuda.tiles import is_near, isotropic_matrix_of, packed_matrix_of, point_of
from adagmm_o3d.kernels.cuda.tuples import adder, column_storer
from adagmm_o3d.kernels.layout import FACTOR, HUE, ISOTROPIC_FACTOR, ISOTROPIC_HUE, MATRIX, SHARE

convolved_full, convolved_isotropic = formulas.convolved_full, formulas.convolved_isotropic
density_of = formulas.density_of

# Sums of a source point: layout.WEIGHT to PULL, then the density. Of isotropic ones the precision is one number.
ROWS, ISOTROPIC_ROWS = 12, 7
ROW_DENSITY = 11
# Tiles summed in float32 before float64 takes over.
FLUSH = 4


@fast
def pair_full(x, j, y, b, planar, unlike):
    """What the pair of source point y, its covariance b, and target point j of the tile `x` adds to the sums of y;
    `unlike` is the capped distance of their colours, or zero."""
    d, s = offset(y, point_at(x, j)), combined(packed_at(x, j), b)
    height, inverse, q, vx, vy, vz, c0, c1, c2, c3, c4, c5 = convolved_full(
        x[j, SHARE], d.x, d.y, d.z, s.xx, s.xy, s.xz, s.yy, s.yz, s.zz
    )
    g = density_of(height, q + unlike)
    c = g * x[j, FACTOR]
    k = c * inverse
    return (
        c, c * q,
        k * c0, k * c1, k * c2, k * c3, k * c4, k * c5,
        k * vx, k * vy, k * vz,
        g,
    )  # fmt: skip


@fast
def pair_isotropic(x, j, y, b, planar, unlike):
    """The same where every covariance is a multiple of the identity: weight, energy, precision, pull, density."""
    d = offset(y, point_at(x, j))
    height, precision, q = convolved_isotropic(x[j, SHARE], d.x, d.y, d.z, x[j, MATRIX] + b, planar)
    g = density_of(height, q + unlike)
    c = g * x[j, ISOTROPIC_FACTOR]
    k = c * precision
    return c, c * q, k, k * d.x, k * d.y, k * d.z, g


@fast
def unfolded(s):
    """Isotropic sums as those of ROWS."""
    weight, energy, precision, ux, uy, uz, density = s
    return weight, energy, precision, 0.0, 0.0, precision, 0.0, precision, ux, uy, uz, density


@fast
def column_factor(density, uniform, mutuality):
    """(uniform / (density + uniform))**mutuality: what a target point's posterior does to the weights of its pairs."""
    return math.exp2(mutuality * math.log2(uniform / (density + uniform)))


def _build(isotropic, coloured, stamp):
    """The kernel for one kind of matrices, with colours or without; `stamp` keeps its cache fresh."""
    matrix_of = isotropic_matrix_of if isotropic else packed_matrix_of
    factor, hue = (ISOTROPIC_FACTOR, ISOTROPIC_HUE) if isotropic else (FACTOR, HUE)
    pair = pair_isotropic if isotropic else pair_full
    count_of_sums = ISOTROPIC_ROWS if isotropic else ROWS
    add, store = adder(count_of_sums, fast), column_storer(ROWS, fast)
    none, nothing = (F0,) * count_of_sums, (0.0,) * count_of_sums
    hue_of, unlike_at = (colour_of, unlike_from(hue)) if coloured else (no_colour_of, alike)
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
        own_hue = hue_of(hues, own, t)
        total = nothing
        s = none
        pending = 0
        for first in range(share, count, TILE * shares):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t * shares
            near[t] = tile < count and is_near(True, moved_boxes, own, sigma, target_boxes, tile, sigma)
            if cuda.syncthreads_or(near[t]) == 0:
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
                    s = add(s, pair(x, j, y, b, planar, unlike_at(x, j, own_hue, cap)))
                    s = add(s, pair(x, j + 1, y, b, planar, unlike_at(x, j + 1, own_hue, cap)))
                    s = add(s, pair(x, j + 2, y, b, planar, unlike_at(x, j + 2, own_hue, cap)))
                    s = add(s, pair(x, j + 3, y, b, planar, unlike_at(x, j + 3, own_hue, cap)))
                pending += 1
                if pending == FLUSH:
                    total = add(total, s)
                    s = none
                    pending = 0
                cuda.syncthreads()
            cuda.syncthreads()
        total = add(total, s)
        store(rows[share], 0, own * TILE + t, unfolded(total) if isotropic else total)

    return convolved_rows


convolved_rows_isotropic = _build(True, False, source_stamp())
convolved_rows_full = _build(False, False, source_stamp())
coloured_rows_isotropic = _build(True, True, source_stamp())
coloured_rows_full = _build(False, True, source_stamp())
