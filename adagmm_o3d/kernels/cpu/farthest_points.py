"""Well-spread representatives of a cloud, and which of them each point belongs to."""

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.compiling import SERIAL_KERNEL_FLAGS, source_stamp


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def farthest_points(points, count, nearest):
        """Choose `count` of (3, n) points, each the farthest from those before, the first the farthest from the origin.

        `nearest` (n,) receives which choice every point is nearest to.
        """
        _ = stamp
        n = points.shape[1]
        distances = np.empty(n, np.float64)
        chosen = 0
        farthest = -1.0
        for i in range(n):
            distances[i] = np.inf
            d = points[0, i] ** 2 + points[1, i] ** 2 + points[2, i] ** 2
            if d > farthest:
                farthest, chosen = d, i
        for c in range(count):
            x, y, z = points[0, chosen], points[1, chosen], points[2, chosen]
            farthest = -1.0
            following = 0
            for i in range(n):
                d = (points[0, i] - x) ** 2 + (points[1, i] - y) ** 2 + (points[2, i] - z) ** 2
                if d < distances[i]:
                    distances[i] = d
                    nearest[i] = c
                if distances[i] > farthest:
                    farthest, following = distances[i], i
            chosen = following

    return farthest_points


farthest_points = _build(source_stamp())
