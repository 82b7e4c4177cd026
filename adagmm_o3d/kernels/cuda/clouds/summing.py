"""Sums and bounds over all points of a table (see `inspecting`), by blocks whose results the host puts together."""

from numba import float64

from adagmm_o3d.kernels.cuda.front_end import TILE, cuda, exact, kernel, source_stamp
from adagmm_o3d.kernels.cuda.reductions import PADDED, reduce_tile
from adagmm_o3d.kernels.cuda.tiles import extreme
from adagmm_o3d.kernels.cuda.tuples import column_storer

# Blocks that fill a GPU, each with its own share of the points: a few kilobytes for the host.
MOST_BLOCKS = 256
# The sum of the weights, of the weighted offsets, and of their products, packed.
MOMENTS = 10
FIRST, SECOND = 1, 4
store_moments = column_storer(MOMENTS, exact)
# Beyond any coordinate.
BEYOND = 1.7e308


def _build_bounds(stamp):
    @kernel
    def bounds(points, partials):
        """The least coordinates (3) and the greatest (3) of the points of each block: `partials` (6, blocks)."""
        _ = stamp
        corners = cuda.shared.array((TILE, 6), float64)
        t = cuda.threadIdx.x
        low0 = low1 = low2 = BEYOND
        high0 = high1 = high2 = -BEYOND
        for i in range(cuda.blockIdx.x * TILE + t, points.shape[1], cuda.gridDim.x * TILE):
            x, y, z = points[0, i], points[1, i], points[2, i]
            low0, low1, low2 = min(low0, x), min(low1, y), min(low2, z)
            high0, high1, high2 = max(high0, x), max(high1, y), max(high2, z)
        corners[t, 0] = low0
        corners[t, 1] = low1
        corners[t, 2] = low2
        corners[t, 3] = high0
        corners[t, 4] = high1
        corners[t, 5] = high2
        cuda.syncthreads()
        if t < 6:
            partials[t, cuda.blockIdx.x] = extreme(corners, t)

    return bounds


def _build_moments(stamp):
    @kernel
    def moments(points, weights, origin, shift, scale, partials):
        """Weighted moments of ((p - origin) - shift) / scale over the points of each block, (MOMENTS, blocks).

        weights : (n,) float64.   origin, shift : (3,) float64 tuples, apart so that far clouds keep their digits.
        """
        _ = stamp
        sums = cuda.shared.array((MOMENTS, PADDED), float64)
        t = cuda.threadIdx.x
        s = sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = 0.0
        for i in range(cuda.blockIdx.x * TILE + t, points.shape[1], cuda.gridDim.x * TILE):
            w = weights[i]
            x = ((points[0, i] - origin[0]) - shift[0]) / scale
            y = ((points[1, i] - origin[1]) - shift[1]) / scale
            z = ((points[2, i] - origin[2]) - shift[2]) / scale
            s += w
            sx += w * x
            sy += w * y
            sz += w * z
            sxx += w * x * x
            sxy += w * x * y
            sxz += w * x * z
            syy += w * y * y
            syz += w * y * z
            szz += w * z * z
        store_moments(sums, 0, t, (s, sx, sy, sz, sxx, sxy, sxz, syy, syz, szz))
        cuda.syncthreads()
        reduce_tile(sums, MOMENTS, t, cuda.blockIdx.x, partials)

    return moments


bounds = _build_bounds(source_stamp())
moments = _build_moments(source_stamp())
