"""How far points are from their nearest neighbours in their own cloud, for a few of them."""

import math

from numba import njit

from adagmm_o3d.kernels.cpu.compiling import SERIAL_KERNEL_FLAGS, source_stamp


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def nearest_other_sq(points, probes, squares):
        """`squares` (k,) receives the squared distance of the points at `probes` (k,) to the nearest other of (3, n).

        One by one: for some hundred probes a tree takes longer to build.
        """
        _ = stamp
        for p in range(len(probes)):
            own = probes[p]
            x, y, z = points[0, own], points[1, own], points[2, own]
            least = math.inf
            for first, last in ((0, own), (own + 1, points.shape[1])):
                for i in range(first, last):
                    d = (points[0, i] - x) ** 2 + (points[1, i] - y) ** 2 + (points[2, i] - z) ** 2
                    if d < least:
                        least = d
            squares[p] = least

    return nearest_other_sq


nearest_other_sq = _build(source_stamp())
