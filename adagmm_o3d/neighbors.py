"""Exact nearest neighbours in the plane and in space, by Open3D's k-d tree, or by our own where there is no Open3D."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.errors import InputError
from adagmm_o3d.lazy_open3d import is_installed, o3d


class _Search(Protocol):
    def query(self, queries: Array, k: int) -> tuple[NDArray[np.int64], Array]:
        """Indices (M, k) and squared distances (M, k), nearest first."""


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
        self._search: _Search = Open3DSearch(points) if is_installed() else OwnSearch(points)

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
        return self._search.query(np.ascontiguousarray(queries, np.float64), k)


class Open3DSearch:
    """Open3D's `NearestNeighborSearch`."""

    def __init__(self, points: Array) -> None:
        # the index reads this memory in place, so it is kept alive with it
        self._points = o3d.core.Tensor.from_numpy(points)
        self._index = o3d.core.nns.NearestNeighborSearch(self._points)
        self._index.knn_index()

    def query(self, queries: Array, k: int) -> tuple[NDArray[np.int64], Array]:
        indices, squares = self._index.knn_search(o3d.core.Tensor.from_numpy(queries), k)
        return indices.numpy(), squares.numpy()


class OwnSearch:
    """The kernel `nearest_k`."""

    def __init__(self, points: Array) -> None:
        # Compiled kernels come with Numba, which is imported with the first search.
        from adagmm_o3d.kernels.cpu.nearest_k import build_tree

        self._order, *self._planes = build_tree(points)
        self._tree = points[self._order]

    def query(self, queries: Array, k: int) -> tuple[NDArray[np.int64], Array]:
        from adagmm_o3d.kernels.cpu.nearest_k import nearest_k

        indices, squares = np.empty((len(queries), k), np.int64), np.empty((len(queries), k))
        nearest_k(self._tree, self._order, *self._planes, queries, indices, squares)
        return indices, squares
