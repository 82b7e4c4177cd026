"""From the sums of every source point to the few numbers that the M-step needs, in float64 and always in one order.

The shares of the other cloud are added up for each point, the points of a tile by one block, the tiles by `total`.
"""

from numba import float64

from adagmm_o3d.kernels.cuda.adaptive_rows import NOTHING as NO_ADAPTIVE
from adagmm_o3d.kernels.cuda.convolved_rows import NOTHING as NO_CONVOLVED
from adagmm_o3d.kernels.cuda.convolved_rows import ROW_DENSITY
from adagmm_o3d.kernels.cuda.front_end import F0, TILE, cuda, exact, exact_formulas, kernel, source_stamp
from adagmm_o3d.kernels.layout import (
    ENERGY,
    HESSIAN,
    MATRIX,
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


@exact
def summed_adaptive(rows, m):
    """The sums of point m over all shares, side by side, so that the loads do not wait for each other."""
    s = NO_ADAPTIVE
    for share in range(rows.shape[0]):
        s = (
            s[0] + rows[share, 0, m],
            s[1] + rows[share, 1, m],
            s[2] + rows[share, 2, m],
            s[3] + rows[share, 3, m],
            s[4] + rows[share, 4, m],
            s[5] + rows[share, 5, m],
            s[6] + rows[share, 6, m],
            s[7] + rows[share, 7, m],
            s[8] + rows[share, 8, m],
            s[9] + rows[share, 9, m],
            s[10] + rows[share, 10, m],
            s[11] + rows[share, 11, m],
            s[12] + rows[share, 12, m],
            s[13] + rows[share, 13, m],
        )
    return s


@exact
def summed_convolved(rows, m):
    """The same for the sums of `convolved_rows`."""
    s = NO_CONVOLVED
    for share in range(rows.shape[0]):
        s = (
            s[0] + rows[share, 0, m],
            s[1] + rows[share, 1, m],
            s[2] + rows[share, 2, m],
            s[3] + rows[share, 3, m],
            s[4] + rows[share, 4, m],
            s[5] + rows[share, 5, m],
            s[6] + rows[share, 6, m],
            s[7] + rows[share, 7, m],
            s[8] + rows[share, 8, m],
            s[9] + rows[share, 9, m],
            s[10] + rows[share, 10, m],
            s[11] + rows[share, 11, m],
        )
    return s


@exact
def store_normal_equations(sums, t, terms):
    """The 27 `terms` of point t into layout.HESSIAN to TOTAL_WEIGHT; a tuple has no index at run time."""
    sums[HESSIAN, t] = terms[0]
    sums[HESSIAN + 1, t] = terms[1]
    sums[HESSIAN + 2, t] = terms[2]
    sums[HESSIAN + 3, t] = terms[3]
    sums[HESSIAN + 4, t] = terms[4]
    sums[HESSIAN + 5, t] = terms[5]
    sums[HESSIAN + 6, t] = terms[6]
    sums[HESSIAN + 7, t] = terms[7]
    sums[HESSIAN + 8, t] = terms[8]
    sums[HESSIAN + 9, t] = terms[9]
    sums[HESSIAN + 10, t] = terms[10]
    sums[HESSIAN + 11, t] = terms[11]
    sums[HESSIAN + 12, t] = terms[12]
    sums[HESSIAN + 13, t] = terms[13]
    sums[HESSIAN + 14, t] = terms[14]
    sums[HESSIAN + 15, t] = terms[15]
    sums[HESSIAN + 16, t] = terms[16]
    sums[HESSIAN + 17, t] = terms[17]
    sums[HESSIAN + 18, t] = terms[18]
    sums[HESSIAN + 19, t] = terms[19]
    sums[HESSIAN + 20, t] = terms[20]
    sums[HESSIAN + 21, t] = terms[21]
    sums[HESSIAN + 22, t] = terms[22]
    sums[HESSIAN + 23, t] = terms[23]
    sums[HESSIAN + 24, t] = terms[24]
    sums[HESSIAN + 25, t] = terms[25]
    sums[HESSIAN + 26, t] = terms[26]


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
        b0 = moved[tile, MATRIX, t]
        if isotropic:
            b1 = b2 = b4 = F0
            b3 = b5 = b0
        else:
            b1, b2, b3 = (
                moved[tile, MATRIX + 1, t],
                moved[tile, MATRIX + 2, t],
                moved[tile, MATRIX + 3, t],
            )
            b4, b5 = moved[tile, MATRIX + 4, t], moved[tile, MATRIX + 5, t]
        terms = normal_equations(
            moved[tile, 0, t],
            moved[tile, 1, t],
            moved[tile, 2, t],
            amplitude * s[PRECISION] + w * b0,
            amplitude * s[PRECISION + 1] + w * b1,
            amplitude * s[PRECISION + 2] + w * b2,
            amplitude * s[PRECISION + 3] + w * b3,
            amplitude * s[PRECISION + 4] + w * b4,
            amplitude * s[PRECISION + 5] + w * b5,
            amplitude * s[PULL],
            amplitude * s[PULL + 1],
            amplitude * s[PULL + 2],
            amplitude * s[TORQUE],
            amplitude * s[TORQUE + 1],
            amplitude * s[TORQUE + 2],
        )
        store_normal_equations(sums, t, terms)
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
        terms = normal_equations(
            moved[tile, 0, t],
            moved[tile, 1, t],
            moved[tile, 2, t],
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
        store_normal_equations(sums, t, terms)
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
reduce_adaptive_anisotropic = _build_adaptive(False, source_stamp())
reduce_convolved = _build_convolved(source_stamp())
reduce_columns = _build_columns(source_stamp())
reduce_nearest = _build_nearest(source_stamp())
total = _build_total(source_stamp())
