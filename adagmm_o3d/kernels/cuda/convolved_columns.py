"""The density of the source mixture at every target point: the pairs of `convolved_rows` seen from the other side.

On the CPU one pass leaves both. Here the columns of a block of pairs would have to be added up across blocks, in a
fixed order and without atomics; a second, lighter pass is simpler and needs no memory.
"""

from numba import float32, int32

from adagmm_o3d.kernels.cuda.front_end import F0, TILE, cuda, fast, fast_kernel, formulas, source_stamp
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
from adagmm_o3d.kernels.layout import FACTOR, HUE, ISOTROPIC_FACTOR, ISOTROPIC_HUE, MATRIX, SHARE

convolved_full, convolved_isotropic = formulas.convolved_full, formulas.convolved_isotropic
density_of = formulas.density_of

# Tiles summed in float32 before float64 takes over.
FLUSH = 4


@fast
def density_full(y, j, x, a, planar, unlike):
    """What source point j of the tile `y` adds to the density at target point x, its covariance a; `unlike` is the
    capped distance of their colours, or zero."""
    d, s = offset(point_at(y, j), x), combined(packed_at(y, j), a)
    height, _, q, _, _, _, _, _, _, _, _, _ = convolved_full(
        y[j, SHARE], d.x, d.y, d.z, s.xx, s.xy, s.xz, s.yy, s.yz, s.zz
    )
    return density_of(height, q + unlike)


@fast
def density_isotropic(y, j, x, a, planar, unlike):
    """The same where every covariance is a multiple of the identity."""
    d = offset(point_at(y, j), x)
    height, _, q = convolved_isotropic(y[j, SHARE], d.x, d.y, d.z, y[j, MATRIX] + a, planar)
    return density_of(height, q + unlike)


def _build(isotropic, coloured, stamp):
    """The kernel for one kind of matrices, with colours or without; `stamp` keeps its cache fresh."""
    matrix_of = isotropic_matrix_of if isotropic else packed_matrix_of
    density = density_isotropic if isotropic else density_full
    # A tile ends where a factor would be.
    components, hue = (ISOTROPIC_FACTOR, ISOTROPIC_HUE) if isotropic else (FACTOR, HUE)
    hue_of, unlike_at = (colour_of, unlike_from(hue)) if coloured else (no_colour_of, alike)
    # Whole 16-byte words, which the compiler then loads at once.
    width = 4 * -(-(hue + 3 if coloured else components) // 4)

    @fast_kernel
    def convolved_columns(target, target_boxes, sigma, planar, moved, moved_boxes, hues, target_hues, cap, parts):
        """One block for each target tile (x) and share of the source tiles (y), one thread for each target point.

        hues, target_hues : (tiles, 3, TILE) float32 colours of source and target, read where these count.
        parts : (shares, target tiles x TILE) float64 densities, overwritten.
        """
        _ = stamp
        y = cuda.shared.array((TILE, width), float32)
        near = cuda.shared.array(TILE, int32)
        t = cuda.threadIdx.x
        own = cuda.blockIdx.x
        share = cuda.blockIdx.y
        shares = cuda.gridDim.y
        count = moved.shape[0]
        x, a = point_of(target, own, t), matrix_of(target, own, t, sigma)
        own_hue = hue_of(target_hues, own, t)
        total = 0.0
        s = F0
        pending = 0
        for first in range(share, count, TILE * shares):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t * shares
            near[t] = tile < count and is_near(True, target_boxes, own, sigma, moved_boxes, tile, sigma)
            if cuda.syncthreads_or(near[t]) == 0:
                continue
            for k in range(TILE):
                if near[k] == 0:
                    continue
                tile = first + k * shares
                for i in range(components):
                    y[t, i] = moved[tile, i, t]
                if coloured:
                    for i in range(3):
                        y[t, hue + i] = hues[tile, i, t]
                cuda.syncthreads()
                for j in range(0, TILE, 4):
                    s += density(y, j, x, a, planar, unlike_at(y, j, own_hue, cap))
                    s += density(y, j + 1, x, a, planar, unlike_at(y, j + 1, own_hue, cap))
                    s += density(y, j + 2, x, a, planar, unlike_at(y, j + 2, own_hue, cap))
                    s += density(y, j + 3, x, a, planar, unlike_at(y, j + 3, own_hue, cap))
                pending += 1
                if pending == FLUSH:
                    total += s
                    s = F0
                    pending = 0
                cuda.syncthreads()
            cuda.syncthreads()
        parts[share, own * TILE + t] = total + s

    return convolved_columns


convolved_columns_isotropic = _build(True, False, source_stamp())
convolved_columns_full = _build(False, False, source_stamp())
coloured_columns_isotropic = _build(True, True, source_stamp())
coloured_columns_full = _build(False, True, source_stamp())
