"""Exact nearest neighbours in the plane and in space, by Open3D's k-d tree."""

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.errors import InputError


class NeighborIndex:
    """A k-d tree over points, asked as often as needed.

    Parameters
    ----------
    points : (N, D) float64, C-contiguous, at least one point.
    name : what an error calls them.

    Raises
    ------
    InputError  if there are no points.
    """

    def __init__(self, points: Array, *, name: str = "points"):
        if len(points) == 0:
            raise InputError(f"{name}: expected at least one point, got none")
        self._count = len(points)
        # the index reads this memory in place, so it is kept alive with it
        self._points = o3d.core.Tensor.from_numpy(points)
        self._index = o3d.core.nns.NearestNeighborSearch(self._points)
        self._index.knn_index()

    def query(self, queries: Array, knn: int = 1) -> tuple[NDArray[np.int64], Array]:
        """The nearest points of every query, nearest first.

        Parameters
        ----------
        queries : (M, D) float64.
        knn : how many; all points where there are fewer.

        Returns
        -------
        indices (M, k) int64 and squared distances (M, k) float64, k = min(knn, N).
        """
        k = min(knn, self._count)
        if len(queries) == 0:
            return np.empty((0, k), np.int64), np.empty((0, k))
        tensor = o3d.core.Tensor.from_numpy(np.ascontiguousarray(queries, np.float64))
        indices, squares = self._index.knn_search(tensor, k)
        return indices.numpy(), squares.numpy()
