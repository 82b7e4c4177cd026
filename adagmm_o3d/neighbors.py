"""Exact nearest neighbours in the plane and in space."""

import math

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.errors import InputError

# With fewer neighbours to find than this for each thread, starting it costs more than it brings.
FOUND_PER_THREAD = 20_000


class NeighborIndex:
    """A k-d tree over points, asked as often as needed.

    Parameters
    ----------
    points : (N, D) float64, at least one point.
    name : what an error calls them.

    Raises
    ------
    InputError  if there are no points.
    """

    def __init__(self, points: Array, *, name: str = "points"):
        if len(points) == 0:
            raise InputError(f"{name}: expected at least one point, got none")
        # Compiled kernels come with Numba, which is imported with the first search.
        from adagmm_o3d.kernels.cpu.nearest_k import build_tree, count_nodes

        points = _in_space(points)
        self._order = np.empty(len(points), np.int64)
        self._boxes = np.empty((count_nodes(len(points)), 2, 3))
        build_tree(points, self._order, self._boxes)
        self._tree = points[self._order]

    def query(self, queries: Array, knn: int = 1, *, within: float = math.inf) -> tuple[NDArray[np.int64], Array]:
        """The nearest points of every query, nearest first, of those equally near the first.

        Parameters
        ----------
        queries : (M, D) float64.
        knn : how many; all points where there are fewer.
        within : no farther than this.

        Returns
        -------
        indices (M, k) int64 and squared distances (M, k) float64, k = min(knn, N); N and `within` squared for those
        that are farther.
        """
        from adagmm_o3d.kernels.cpu.nearest_k import nearest_k
        from adagmm_o3d.kernels.cpu.ranges import run_in_ranges

        k = min(knn, len(self._tree))
        queries = _in_space(queries)
        indices, squares = np.empty((len(queries), k), np.int64), np.full((len(queries), k), within * within)

        def run(first: int, last: int) -> None:
            part = slice(first, last)
            nearest_k(self._tree, self._order, self._boxes, queries[part], indices[part], squares[part])

        run_in_ranges(nearest_k, run, len(queries), len(queries) * k // FOUND_PER_THREAD)
        return indices, squares


def _in_space(points: Array) -> Array:
    """(n, D) points of the plane or of space as (n, 3)."""
    if points.shape[1] == 3:
        return np.ascontiguousarray(points, np.float64)
    return np.column_stack([points, np.zeros(len(points))])
