"""Covariances of the surface around each point on the GPU, as `uncertainty.estimate_surface_covariances` makes them."""

import numpy as np
from numba import float64, int32

from adagmm_o3d.kernels.cuda.clouds.eigen import eigen
from adagmm_o3d.kernels.cuda.clouds.inspecting import COVARIANCE, LARGEST, VARIANCE
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda, exact, kernel, source_stamp
from adagmm_o3d.kernels.cuda.tiles import extreme, gap_sq
from adagmm_o3d.kernels.limits import EPSILON, KNN, LINE_RATIO

# Farther than any two points.
FAR = np.float64(1.7e308)


@exact
def offer(distances, indices, t, kept, worst, d, i):
    """Point i at the squared distance d put in place of the farthest of thread t's `kept` points; the new farthest."""
    if d >= worst:
        return worst
    farthest = 0
    for k in range(1, kept):
        if distances[k, t] > distances[farthest, t]:
            farthest = k
    distances[farthest, t] = d
    indices[farthest, t] = i
    worst = distances[0, t]
    for k in range(1, kept):
        worst = max(worst, distances[k, t])
    return worst


def _build_boxes(stamp):
    @kernel
    def point_boxes(points, boxes):
        """One block for each tile of ordered points, a table; `boxes` (tiles, 6) float64, low and high corners."""
        _ = stamp
        corners = cuda.shared.array((TILE, 6), float64)
        t = cuda.threadIdx.x
        tile = cuda.blockIdx.x
        i = min(tile * TILE + t, points.shape[1] - 1)
        for k in range(3):
            corners[t, k] = points[k, i]
            corners[t, k + 3] = points[k, i]
        cuda.syncthreads()
        if t < 6:
            boxes[tile, t] = extreme(corners, t)

    return point_boxes


def _build_surface(stamp):
    @kernel
    def surface_covariances(ordered, boxes, order, points):
        """One block for each tile of ordered points (a table), one thread for each point and its nearest ones.

        Tiles are visited from the block's own outwards along the curve first, then every one that may hold a nearer
        point than the farthest kept so far. The covariances go to `points`, the table in the cloud's own order.
        """
        _ = stamp
        x = cuda.shared.array((TILE, 3), float64)
        distances = cuda.shared.array((KNN, TILE), float64)
        indices = cuda.shared.array((KNN, TILE), int32)
        reach = cuda.shared.array(TILE, float64)
        near = cuda.shared.array(TILE, int32)
        t = cuda.threadIdx.x
        own = cuda.blockIdx.x
        n = ordered.shape[1]
        count = boxes.shape[0]
        kept = min(KNN, n)
        m = min(own * TILE + t, n - 1)
        y0, y1, y2 = ordered[0, m], ordered[1, m], ordered[2, m]
        for k in range(kept):
            distances[k, t] = FAR
        worst = FAR
        for first in range(-TILE, count, TILE):
            reach[t] = worst
            cuda.syncthreads()
            limit = reach[0]
            for k in range(1, TILE):
                limit = max(limit, reach[k])
            if first < 0:
                # the block's own tile and the next ones along the curve
                tile = own + t - 1
                near[t] = t < 3 and tile >= 0 and tile < count
            else:
                tile = first + t
                near[t] = (
                    tile < count and (tile < own - 1 or tile > own + 1) and gap_sq(boxes, own, boxes, tile) < limit
                )
            if cuda.syncthreads_or(near[t]) == 0:
                continue
            for k in range(TILE):
                if near[k] == 0:
                    continue
                tile = own + k - 1 if first < 0 else first + k
                for i in range(3):
                    x[t, i] = ordered[i, min(tile * TILE + t, n - 1)]
                cuda.syncthreads()
                for j in range(min(TILE, n - tile * TILE)):
                    d0, d1, d2 = x[j, 0] - y0, x[j, 1] - y1, x[j, 2] - y2
                    worst = offer(distances, indices, t, kept, worst, d0 * d0 + d1 * d1 + d2 * d2, tile * TILE + j)
                cuda.syncthreads()
            cuda.syncthreads()
        mean0 = mean1 = mean2 = 0.0
        for k in range(kept):
            i = indices[k, t]
            mean0 += ordered[0, i] - y0
            mean1 += ordered[1, i] - y1
            mean2 += ordered[2, i] - y2
        mean0, mean1, mean2 = mean0 / kept, mean1 / kept, mean2 / kept
        s0 = s1 = s2 = s3 = s4 = s5 = 0.0
        for k in range(kept):
            i = indices[k, t]
            d0, d1, d2 = ordered[0, i] - y0 - mean0, ordered[1, i] - y1 - mean1, ordered[2, i] - y2 - mean2
            s0 += d0 * d0
            s1 += d0 * d1
            s2 += d0 * d2
            s3 += d1 * d1
            s4 += d1 * d2
            s5 += d2 * d2
        _, middle, _, n0, n1, n2, _, _, _, _, _, _ = eigen(s0, s1, s2, s3, s4, s5)
        across, variance = 1.0 - EPSILON, EPSILON ** (1.0 / 3.0)
        if not middle > LINE_RATIO * (s0 + s3 + s5):
            across, variance = 0.0, 1.0
        if own * TILE + t < n:
            i = order[m]
            points[COVARIANCE, i] = 1.0 - across * n0 * n0
            points[COVARIANCE + 1, i] = -across * n0 * n1
            points[COVARIANCE + 2, i] = -across * n0 * n2
            points[COVARIANCE + 3, i] = 1.0 - across * n1 * n1
            points[COVARIANCE + 4, i] = -across * n1 * n2
            points[COVARIANCE + 5, i] = 1.0 - across * n2 * n2
            points[VARIANCE, i] = variance
            points[LARGEST, i] = 1.0

    return surface_covariances


point_boxes = _build_boxes(source_stamp())
surface_covariances = _build_surface(source_stamp())
