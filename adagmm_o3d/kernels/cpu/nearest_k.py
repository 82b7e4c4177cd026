"""The k nearest points of each query, by a k-d tree."""

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.compiling import EXACT_KERNEL_FLAGS, POINTWISE_FLAGS, source_stamp

# Runs of so few points are searched one by one.
LEAF = 16
# Halving 2^63 points this often leaves one.
DEEPEST = 64


def count_nodes(count: int) -> int:
    """The boxes of a tree over so many points, with the one that stands at 0 for none."""
    nodes = 2
    while count > LEAF:
        count, nodes = (count + 1) // 2, 2 * nodes
    return nodes


@njit(**POINTWISE_FLAGS)
def halve(order, values, first, last):
    """Reorder a run so that no value before its middle is above any from there on.

    What it is parted by stands anywhere: the ends and the middle of a ring of points are its farthest ones.

    Source
    ------
    C. A. R. Hoare: Algorithm 65: find, Communications of the ACM 4, 1961.
    """
    middle = (first + last) // 2
    low, high = first, last - 1
    place = 1
    while low < high:
        place = (1103515245 * place + 12345) % 2147483648
        pivot = values[low + place % (high - low + 1)]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit(**POINTWISE_FLAGS)
def gap_sq(box, x, y, z):
    """Squared distance of a point from a box (2, 3), 0 within it."""
    dx = max(box[0, 0] - x, x - box[1, 0], 0.0)
    dy = max(box[0, 1] - y, y - box[1, 1], 0.0)
    dz = max(box[0, 2] - z, z - box[1, 2], 0.0)
    return dx * dx + dy * dy + dz * dz


def _build(stamp):
    """The kernels that are called from Python; `stamp` keeps their cache fresh."""

    @njit(**EXACT_KERNEL_FLAGS)
    def build_tree(points, order, boxes):
        """Halve runs of (N, 3) points across their longest extent until they are leaves.

        `order` (N,) receives the points' indices, run by run; `boxes` (2^k, 2, 3), for the run of all points at 1 and
        for the halves of the one at n at 2 n and 2 n + 1, the least and the largest of its coordinates.
        """
        _ = stamp
        values = np.empty(points.shape[0])
        firsts = np.empty(DEEPEST, np.int64)
        lasts = np.empty(DEEPEST, np.int64)
        nodes = np.empty(DEEPEST, np.int64)
        for i in range(points.shape[0]):
            order[i] = i
        firsts[0], lasts[0], nodes[0] = 0, points.shape[0], 1
        waiting = 1
        while waiting > 0:
            waiting -= 1
            first, last, node = firsts[waiting], lasts[waiting], nodes[waiting]
            while True:
                axis, widest = 0, -1.0
                for d in range(3):
                    lowest = highest = points[order[first], d]
                    for i in range(first + 1, last):
                        lowest = min(lowest, points[order[i], d])
                        highest = max(highest, points[order[i], d])
                    boxes[node, 0, d], boxes[node, 1, d] = lowest, highest
                    if highest - lowest > widest:
                        axis, widest = d, highest - lowest
                if last - first <= LEAF:
                    break
                for i in range(first, last):
                    values[i] = points[order[i], axis]
                halve(order, values, first, last)
                middle = (first + last) // 2
                firsts[waiting], lasts[waiting], nodes[waiting] = middle, last, 2 * node + 1
                waiting += 1
                last, node = middle, 2 * node

    @njit(**EXACT_KERNEL_FLAGS)
    def nearest_k(tree, order, boxes, queries, indices, squares):
        """Fill (M, k) `indices` and `squares` with the nearest points of each query, nearest first.

        tree : (N, 3) points in their order.   squares : comes with what they have to be within.
        Of points equally near the one of the smaller index comes first.
        """
        _ = stamp
        k = indices.shape[1]
        firsts = np.empty(DEEPEST, np.int64)
        lasts = np.empty(DEEPEST, np.int64)
        nodes = np.empty(DEEPEST, np.int64)
        bounds = np.empty(DEEPEST, np.float64)
        for m in range(queries.shape[0]):
            x, y, z = queries[m, 0], queries[m, 1], queries[m, 2]
            firsts[0], lasts[0], nodes[0], bounds[0] = 0, tree.shape[0], 1, 0.0
            waiting = 1
            near, far = indices[m], squares[m]
            near[:] = tree.shape[0]
            worst = far[k - 1]
            while waiting > 0:
                waiting -= 1
                first, last, node = firsts[waiting], lasts[waiting], nodes[waiting]
                if bounds[waiting] > worst:
                    continue
                while last - first > LEAF:
                    middle = (first + last) // 2
                    lower, upper = gap_sq(boxes[2 * node], x, y, z), gap_sq(boxes[2 * node + 1], x, y, z)
                    if lower <= upper:
                        firsts[waiting], lasts[waiting], nodes[waiting] = middle, last, 2 * node + 1
                        bounds[waiting] = upper
                        last, node = middle, 2 * node
                    else:
                        firsts[waiting], lasts[waiting], nodes[waiting] = first, middle, 2 * node
                        bounds[waiting] = lower
                        first, node = middle, 2 * node + 1
                    waiting += 1
                for i in range(first, last):
                    square = (x - tree[i, 0]) ** 2 + (y - tree[i, 1]) ** 2 + (z - tree[i, 2]) ** 2
                    if square > worst:
                        continue
                    index = order[i]
                    place = k - 1
                    if square == worst and index > near[place]:
                        continue
                    while place > 0 and (
                        square < far[place - 1] or (square == far[place - 1] and index < near[place - 1])
                    ):
                        far[place], near[place] = far[place - 1], near[place - 1]
                        place -= 1
                    far[place], near[place] = square, index
                    worst = far[k - 1]

    return build_tree, nearest_k


build_tree, nearest_k = _build(source_stamp())
