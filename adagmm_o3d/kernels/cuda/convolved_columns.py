"""The density of the source mixture at every target point: the pairs of `convolved_rows` seen from the other side.

On the CPU one pass leaves both. Here the columns of a block of pairs would have to be added up across blocks, in a
fixed order and without atomics; a second, lighter pass is simpler and needs no memory.
"""

from numba import float32, int32

from adagmm_o3d.kernels.cuda.convolved_rows import unlike_at
from adagmm_o3d.kernels.cuda.front_end import (
    F0,
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
density_of = formulas.density_of

# Tiles summed in float32 before float64 takes over.
FLUSH = 4


@fast
def density_anisotropic(y, j, x, a, unlike):
    """What source point j of the tile `y` adds to the density at target point x (3), its packed covariance a (6);
    `unlike` is the capped distance of their colours, or zero."""
    dx = y[j, X] - x[0]
    dy = y[j, X + 1] - x[1]
    dz = y[j, X + 2] - x[2]
    height, _, q, _, _, _, _, _, _, _, _, _ = convolved_full(
        y[j, SHARE],
        dx,
        dy,
        dz,
        y[j, MATRIX] + a[0],
        y[j, MATRIX + 1] + a[1],
        y[j, MATRIX + 2] + a[2],
        y[j, MATRIX + 3] + a[3],
        y[j, MATRIX + 4] + a[4],
        y[j, MATRIX + 5] + a[5],
    )
    return density_of(height, q + unlike)


@fast
def density_isotropic(y, j, x, a, planar, unlike):
    """The same where every covariance is a multiple of the identity."""
    dx = y[j, X] - x[0]
    dy = y[j, X + 1] - x[1]
    dz = y[j, X + 2] - x[2]
    height, _, q = convolved_isotropic(y[j, SHARE], dx, dy, dz, y[j, MATRIX] + a, planar)
    return density_of(height, q + unlike)


def _build(isotropic, coloured, stamp):
    """The kernel for one kind of matrices, with colours or without; `stamp` keeps its cache fresh."""
    matrix_of = isotropic_matrix_of if isotropic else packed_matrix_of
    # A tile ends where a factor would be.
    components, hue = (ISOTROPIC_FACTOR, ISOTROPIC_HUE) if isotropic else (FACTOR, HUE)
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
        if coloured:
            h0, h1, h2 = target_hues[own, 0, t], target_hues[own, 1, t], target_hues[own, 2, t]
        else:
            h0 = h1 = h2 = F0
        unlike = F0
        total = 0.0
        s = F0
        pending = 0
        for first in range(share, count, TILE * shares):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t * shares
            found = 0
            if tile < count and is_near(True, target_boxes, own, sigma, moved_boxes, tile, sigma):
                found = 1
            near[t] = found
            if cuda.syncthreads_or(found) == 0:
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
                    if isotropic:
                        unlike = unlike_at(y, j, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_isotropic(y, j, x, a, planar, unlike)
                        unlike = unlike_at(y, j + 1, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_isotropic(y, j + 1, x, a, planar, unlike)
                        unlike = unlike_at(y, j + 2, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_isotropic(y, j + 2, x, a, planar, unlike)
                        unlike = unlike_at(y, j + 3, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_isotropic(y, j + 3, x, a, planar, unlike)
                    else:
                        unlike = unlike_at(y, j, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_anisotropic(y, j, x, a, unlike)
                        unlike = unlike_at(y, j + 1, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_anisotropic(y, j + 1, x, a, unlike)
                        unlike = unlike_at(y, j + 2, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_anisotropic(y, j + 2, x, a, unlike)
                        unlike = unlike_at(y, j + 3, hue, h0, h1, h2, cap) if coloured else F0
                        s += density_anisotropic(y, j + 3, x, a, unlike)
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
convolved_columns_anisotropic = _build(False, False, source_stamp())
coloured_columns_isotropic = _build(True, True, source_stamp())
coloured_columns_anisotropic = _build(False, True, source_stamp())
