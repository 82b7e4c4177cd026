"""From the sums of every source point to the few numbers that the M-step needs, in float64 and always in one order.

The shares of the other cloud are added up for each point, the points of a tile by one block, the tiles by `total`.
"""

from numba import float64

from adagmm_o3d.kernels.cuda.adaptive_rows import ROWS as ADAPTIVE_ROWS
from adagmm_o3d.kernels.cuda.convolved_rows import ROW_DENSITY
from adagmm_o3d.kernels.cuda.convolved_rows import ROWS as CONVOLVED_ROWS
from adagmm_o3d.kernels.cuda.front_end import F0, F1, TILE, cuda, exact, exact_formulas, kernel, source_stamp
from adagmm_o3d.kernels.cuda.tiles import Packed, isotropic_matrix_of, packed_matrix_of, point_of
from adagmm_o3d.kernels.cuda.tuples import adder, column_loader, column_storer
from adagmm_o3d.kernels.layout import (
    ENERGY,
    HESSIAN,
    PRECISION,
    PULL,
    TORQUE,
    TOTAL_ENERGY,
    TOTAL_MATCHED,
    TOTAL_SUMS,
    TOTAL_WEIGHT,
    WEIGHT,
)

normal_equations = exact_formulas.normal_equations

# Threads that add up the tiles of one sum.
ADDERS = 4 * TILE
# One column more than needed spreads a column over the banks of the shared memory.
PADDED = TILE + 1


def _build_summed(count):
    """(rows, m) → the `count` sums of point m over all shares, side by side, so that the loads do not wait for each
    other."""
    add, load = adder(count, exact), column_loader(count, exact)
    nothing = (0.0,) * count

    @exact
    def summed(rows, m):
        s = nothing
        for share in range(rows.shape[0]):
            s = add(s, load(rows[share], 0, m))
        return s

    return summed


summed_adaptive, summed_convolved = _build_summed(ADAPTIVE_ROWS), _build_summed(CONVOLVED_ROWS)
store_normal_equations = column_storer(TOTAL_WEIGHT - HESSIAN, exact)


@exact
def reduce_tile(sums, count, t, tile, partials):
    """Thread t's part in adding up the `count` sums of a block's threads, each in the order of the points."""
    for i in range(t, count, TILE):
        total = 0.0
        for k in range(TILE):
            total += sums[i, k]
        partials[i, tile] = total


def _build_adaptive(isotropic, stamp):
    @kernel
    def reduce_adaptive(moved, rows, amplitudes, row_weights, partials):
        """One block for each source tile; see `adaptive_rows`.

        amplitudes (tiles, TILE), row_weights (tiles x TILE,) and partials (TOTAL_SUMS, tiles) float64; the latter two
        are overwritten.
        """
        _ = stamp
        sums = cuda.shared.array((TOTAL_SUMS, PADDED), float64)
        tile = cuda.blockIdx.x
        t = cuda.threadIdx.x
        m = tile * TILE + t
        amplitude = amplitudes[tile, t]
        s = summed_adaptive(rows, m)
        w = amplitude * s[WEIGHT]
        y = point_of(moved, tile, t)
        if isotropic:
            b0 = isotropic_matrix_of(moved, tile, t, F1)
            b = Packed(b0, F0, F0, b0, F0, b0)
        else:
            b = packed_matrix_of(moved, tile, t, F1)
        terms = normal_equations(
            y.x,
            y.y,
            y.z,
            amplitude * s[PRECISION] + w * b.xx,
            amplitude * s[PRECISION + 1] + w * b.xy,
            amplitude * s[PRECISION + 2] + w * b.xz,
            amplitude * s[PRECISION + 3] + w * b.yy,
            amplitude * s[PRECISION + 4] + w * b.yz,
            amplitude * s[PRECISION + 5] + w * b.zz,
            amplitude * s[PULL],
            amplitude * s[PULL + 1],
            amplitude * s[PULL + 2],
            amplitude * s[TORQUE],
            amplitude * s[TORQUE + 1],
            amplitude * s[TORQUE + 2],
        )
        store_normal_equations(sums, HESSIAN, t, terms)
        sums[TOTAL_WEIGHT, t] = w
        sums[TOTAL_ENERGY, t] = amplitude * s[ENERGY]
        sums[TOTAL_MATCHED, t] = 0.0
        row_weights[m] = w
        cuda.syncthreads()
        reduce_tile(sums, TOTAL_SUMS, t, tile, partials)

    return reduce_adaptive


def _build_convolved(stamp):
    @kernel
    def reduce_convolved(moved, rows, weights, uniform, mutuality, posteriors, partials):
        """One block for each source tile; see `convolved_rows`. `uniform` is in the units of the rows.

        weights (tiles, TILE), posteriors (tiles x TILE,) and partials (TOTAL_SUMS, tiles) float64; the latter two are
        overwritten.
        """
        _ = stamp
        sums = cuda.shared.array((TOTAL_SUMS, PADDED), float64)
        tile = cuda.blockIdx.x
        t = cuda.threadIdx.x
        m = tile * TILE + t
        weight = weights[tile, t]
        s = summed_convolved(rows, m)
        density = s[ROW_DENSITY]
        posterior = 1.0 / (density + uniform)
        scale = weight * posterior ** (1.0 - mutuality) * uniform**-mutuality
        y = point_of(moved, tile, t)
        terms = normal_equations(
            y.x,
            y.y,
            y.z,
            scale * s[PRECISION],
            scale * s[PRECISION + 1],
            scale * s[PRECISION + 2],
            scale * s[PRECISION + 3],
            scale * s[PRECISION + 4],
            scale * s[PRECISION + 5],
            scale * s[PULL],
            scale * s[PULL + 1],
            scale * s[PULL + 2],
            0.0,
            0.0,
            0.0,
        )
        store_normal_equations(sums, HESSIAN, t, terms)
        sums[TOTAL_WEIGHT, t] = scale * s[WEIGHT]
        sums[TOTAL_ENERGY, t] = scale * s[ENERGY]
        sums[TOTAL_MATCHED, t] = weight * density * posterior
        posteriors[m] = density * posterior
        cuda.syncthreads()
        reduce_tile(sums, TOTAL_SUMS, t, tile, partials)

    return reduce_convolved


def _build_columns(stamp):
    @kernel
    def reduce_columns(parts, unit, densities, densities32):
        """One thread for each target point; see `convolved_columns`.

        unit : what a density is divided by to leave the kernels' powers of two.   densities : (tiles x TILE,) float64;
        densities32 (tiles, TILE) float32 for the next pass; both are overwritten.
        """
        _ = stamp
        tile = cuda.blockIdx.x
        t = cuda.threadIdx.x
        m = tile * TILE + t
        density = 0.0
        for share in range(parts.shape[0]):
            density += parts[share, m]
        density /= unit
        densities[m] = density
        densities32[tile, t] = density

    return reduce_columns


def _build_nearest(stamp):
    @kernel
    def reduce_nearest(parts, nearest):
        """One thread for each source point: the smallest of its shares (`nearest_sq`) into `nearest` (tiles x TILE)."""
        _ = stamp
        m = cuda.blockIdx.x * TILE + cuda.threadIdx.x
        best = parts[0, m]
        for share in range(1, parts.shape[0]):
            best = min(best, parts[share, m])
        nearest[m] = best

    return reduce_nearest


def _build_total(stamp):
    @kernel
    def total(partials, totals):
        """One block for each sum over the source's tiles, into `totals` (TOTAL_SUMS,)."""
        _ = stamp
        sums = cuda.shared.array(ADDERS, float64)
        i = cuda.blockIdx.x
        t = cuda.threadIdx.x
        s = 0.0
        for tile in range(t, partials.shape[1], ADDERS):
            s += partials[i, tile]
        sums[t] = s
        width = ADDERS // 2
        while width > 0:
            cuda.syncthreads()
            if t < width:
                sums[t] += sums[t + width]
            width //= 2
        if t == 0:
            totals[i] = sums[0]

    return total


reduce_adaptive_isotropic = _build_adaptive(True, source_stamp())
reduce_adaptive_full = _build_adaptive(False, source_stamp())
reduce_convolved = _build_convolved(source_stamp())
reduce_columns = _build_columns(source_stamp())
reduce_nearest = _build_nearest(source_stamp())
total = _build_total(source_stamp())
