"""The k nearest points of each query, by a k-d tree: what Open3D's search does, for where Open3D is not installed."""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cpu.compiling import KERNEL_FLAGS, source_stamp

# Runs of so few points are searched one by one.
LEAF = 16
# Halving 2^63 points this often leaves one.
DEEPEST = 64


def build_tree(points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Order points so that the two halves of a run lie on either side of a plane across the run's longest extent.

    Parameters
    ----------
    points : (N, D) float64.

    Returns
    -------
    order : (N,) int64, indices into `points`.
    axes, splits : (N,) int64 and float64, at the middle of each run that is longer than a leaf: the axis along which it
        is halved, and where.
    """
    order = np.arange(len(points))
    axes, splits = np.zeros(len(points), np.int64), np.zeros(len(points))
    runs = [(0, len(points))]
    while runs:
        first, last = runs.pop()
        if last - first <= LEAF:
            continue
        run = points[order[first:last]]
        axis = int(np.argmax(run.max(axis=0) - run.min(axis=0)))
        middle = (first + last) // 2
        order[first:last] = order[first:last][np.argpartition(run[:, axis], middle - first)]
        axes[middle], splits[middle] = axis, points[order[middle], axis]
        runs += [(first, middle), (middle, last)]
    return order, axes, splits


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def nearest_k(tree, order, axes, splits, queries, indices, squares):
        """Fill (M, k) `indices` and `squares` with the nearest points of each query, nearest first.

        tree : (N, D) points in their order. Of points equally near the one of the smaller index comes first.
        """
        _ = stamp
        k = indices.shape[1]
        dimension = tree.shape[1]
        for m in prange(queries.shape[0]):
            firsts = np.empty(DEEPEST, np.int64)
            lasts = np.empty(DEEPEST, np.int64)
            bounds = np.empty(DEEPEST, np.float64)
            firsts[0], lasts[0], bounds[0] = 0, tree.shape[0], 0.0
            waiting = 1
            squares[m, :] = np.inf
            indices[m, :] = tree.shape[0]
            while waiting > 0:
                waiting -= 1
                first, last = firsts[waiting], lasts[waiting]
                if bounds[waiting] > squares[m, k - 1]:
                    continue
                while last - first > LEAF:
                    middle = (first + last) // 2
                    away = queries[m, axes[middle]] - splits[middle]
                    bounds[waiting] = away * away
                    if away < 0.0:
                        firsts[waiting], lasts[waiting] = middle, last
                        last = middle
                    else:
                        firsts[waiting], lasts[waiting] = first, middle
                        first = middle
                    waiting += 1
                for i in range(first, last):
                    square = 0.0
                    for d in range(dimension):
                        square += (queries[m, d] - tree[i, d]) ** 2
                    index = order[i]
                    place = k
                    while place > 0 and (
                        square < squares[m, place - 1]
                        or (square == squares[m, place - 1] and index < indices[m, place - 1])
                    ):
                        if place < k:
                            squares[m, place] = squares[m, place - 1]
                            indices[m, place] = indices[m, place - 1]
                        place -= 1
                    if place < k:
                        squares[m, place] = square
                        indices[m, place] = index

    return nearest_k


nearest_k = _build(source_stamp())
