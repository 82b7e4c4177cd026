"""Distance from each source point to its nearest target point on the GPU, as in `kernels.cpu.nearest`."""

import numpy as np
from numba import float32, int32

from adagmm_o3d.kernels.cuda.front_end import F0, TILE, cuda, exact, exact_formulas, kernel, source_stamp
from adagmm_o3d.kernels.cuda.tiles import gap_sq

dot = exact_formulas.dot

# Farther than any two points.
FAR = np.float32(3e38)


@exact
def nearer(x, y0, y1, y2, best):
    """The smaller of `best` and the squared distances from a source point to the points of the tile `x`."""
    for j in range(TILE):
        dx = y0 - x[j, 0]
        dy = y1 - x[j, 1]
        dz = y2 - x[j, 2]
        best = min(best, dot(dx, dy, dz, dx, dy, dz))
    return best


def _build(stamp):
    """The kernel; `stamp` keeps its cache fresh."""

    @kernel
    def nearest_sq(moved, moved_boxes, target, target_boxes, parts):
        """One block for each source tile (x) and share of the target tiles (y), one thread for each source point.

        Every share begins with the tile closest to its source tile, so that all know from the start how far to look.
        parts : (shares, source tiles x TILE) float32, overwritten.
        """
        _ = stamp
        x = cuda.shared.array((TILE, 4), float32)
        near = cuda.shared.array(TILE, int32)
        per_thread = cuda.shared.array(TILE, float32)
        t = cuda.threadIdx.x
        own = cuda.blockIdx.x
        share = cuda.blockIdx.y
        shares = cuda.gridDim.y
        count = target.shape[0]
        y0, y1, y2 = moved[own, 0, t], moved[own, 1, t], moved[own, 2, t]
        gap = FAR
        closest = 0
        for tile in range(t, count, TILE):
            d = gap_sq(moved_boxes, own, target_boxes, tile)
            if d < gap:
                gap = d
                closest = tile
        near[t] = closest
        per_thread[t] = gap
        cuda.syncthreads()
        start = near[0]
        gap = per_thread[0]
        for k in range(1, TILE):
            if per_thread[k] < gap:
                gap = per_thread[k]
                start = near[k]
        for i in range(3):
            x[t, i] = target[start, i, t]
        cuda.syncthreads()
        best = nearer(x, y0, y1, y2, FAR)
        for first in range(share, count, TILE * shares):
            # No source point of the block has to look farther than the one that has found least so far.
            per_thread[t] = best
            cuda.syncthreads()
            worst = F0
            for k in range(TILE):
                worst = max(worst, per_thread[k])
            tile = first + t * shares
            near[t] = tile < count and tile != start and gap_sq(moved_boxes, own, target_boxes, tile) < worst
            if cuda.syncthreads_or(near[t]) == 0:
                continue
            for k in range(TILE):
                if near[k] == 0:
                    continue
                tile = first + k * shares
                for i in range(3):
                    x[t, i] = target[tile, i, t]
                cuda.syncthreads()
                best = nearer(x, y0, y1, y2, best)
                cuda.syncthreads()
            cuda.syncthreads()
        parts[share, own * TILE + t] = best

    return nearest_sq


nearest_sq = _build(source_stamp())
