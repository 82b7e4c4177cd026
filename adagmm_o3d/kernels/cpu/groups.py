"""Sums over groups of points, and the cells of space that make groups."""

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.compiling import EXACT_KERNEL_FLAGS, source_stamp


def _build(stamp):
    """The kernels that are called from Python; `stamp` keeps their cache fresh."""

    @njit(**EXACT_KERNEL_FLAGS)
    def add_to_groups(values, weights, groups, sums):
        """To the row of `sums` (k, c) that (n,) `groups` names for each point add its row of (n, c) `values` times its
        weight (n,)."""
        _ = stamp
        for i in range(values.shape[0]):
            group, weight = groups[i], weights[i]
            for c in range(values.shape[1]):
                sums[group, c] += weight * values[i, c]

    @njit(**EXACT_KERNEL_FLAGS)
    def number_cells(points, edges, kinds, bits, numbers):
        """`numbers` (n,) receive the cell, of edge (n,), that each of (n, D) points lies in: its place along each axis
        in so many bits, and above them its kind (n,); a negative one of its own where a place is too far out."""
        _ = stamp
        half = 1 << (bits - 1)
        for i in range(points.shape[0]):
            number = kinds[i]
            for d in range(points.shape[1]):
                place = np.floor(points[i, d] / edges[i])
                if not abs(place) < half:
                    number = -1 - i
                    break
                number = (number << bits) | (np.int64(place) + half)
            numbers[i] = number

    return add_to_groups, number_cells


add_to_groups, number_cells = _build(source_stamp())
