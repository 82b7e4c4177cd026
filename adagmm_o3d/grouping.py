"""Points that are merged: which of them go together, and what the groups have in common."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.sampling import distinct_places

# A cloud is dense when it has so many points, and its cells no more than this share of them.
DENSE_FROM, MOST_LEFT = 10_000, 0.6
# The edge of a dense cloud's cells in radii, halved until there are so many cells: of a cloud whose bulk is small
# beside its radius, or of a curve, larger ones would leave too little.
CELL, FEWEST = 0.025, 5_000
# A cell's number: its place along each axis in so many bits, and above them one of so many kinds.
AXIS_BITS, MOST_KINDS = 19, 32


class Groups:
    """Points with the same label, in the order of the labels.

    labels : (n,) of the points.   weights : (n,) of the points.   total : (k,) of the groups.
    """

    def __init__(self, labels: NDArray[np.int64], weights: Array) -> None:
        order = np.argsort(labels, kind="stable")
        ordered = labels[order]
        begins = np.concatenate([[True], ordered[1:] != ordered[:-1]])
        self._count = int(begins.sum())
        self._groups = np.empty(len(labels), np.int64)
        self._groups[order] = np.cumsum(begins) - 1
        self._weights = np.ascontiguousarray(weights, np.float64)

    def __len__(self) -> int:
        return self._count

    @cached_property
    def total(self) -> Array:
        return np.asarray(np.bincount(self._groups, self._weights, self._count), np.float64)

    def means(self, values: Array) -> Array:
        """(k, …) weighted means of (n, …) values of the points."""
        # Compiled kernels come with Numba, which is imported with the first of them.
        from adagmm_o3d.kernels.cpu.groups import add_to_groups

        flat = np.ascontiguousarray(values.reshape(len(values), -1), np.float64)
        sums = np.zeros((self._count, flat.shape[1]))
        add_to_groups(flat, self._weights, self._groups, sums)
        return (sums / self.total[:, None]).reshape(-1, *values.shape[1:])

    def each(self, values: Array) -> Array:
        """(n, …) for each point what (k, …) values say of its group."""
        return values[self._groups]


def even_edge(points: Array) -> float | None:
    """The edge of even cells for (n, D) points: the widest, or a half, a quarter of it; None where the cloud is not
    dense."""
    if len(points) < DENSE_FROM:
        return None
    edge = widest = widest_edge(points)
    while edge > 0.0:
        cells = len(cells_of(points, edge))
        if cells > MOST_LEFT * len(points):
            break
        if cells >= FEWEST:
            return edge
        if edge == widest and in_few_places(points):
            break
        edge *= 0.5
    return None


def widest_edge(points: Array) -> float:
    """CELL times the root mean square distance of (n, D) points from their centroid."""
    return CELL * math.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())


def in_few_places(points: Array) -> bool:
    """Whether (n, D) points are given again and again in so few places that no cells can be FEWEST."""
    return len(distinct_places(points)) < FEWEST


def cells_of(points: Array, edge: float) -> Groups:
    """(n, D) points by the cell of that edge that they lie in, counted from the centroid."""
    return Groups(cell_numbers(points - points.mean(axis=0), np.full(len(points), edge)), np.ones(len(points)))


def block_numbers(points: Array, edge: float) -> NDArray[np.intp]:
    """(n,) the number, from 0 on, of the cube of that edge that each of (n, D) points lies in."""
    return np.unique(np.floor(points / edge), axis=0, return_inverse=True)[1].ravel()


def cell_numbers(points: Array, edges: Array, kinds: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    """(n,) numbers of the cells, of edges (n,), that points (n, D) lie in, each kind (n,) of points by itself.

    Negative, and a point's own, where that is too far out to have one. `kinds` are from 0 to MOST_KINDS - 1.
    """
    from adagmm_o3d.kernels.cpu.groups import number_cells

    numbers = np.empty(len(points), np.int64)
    kinds = np.zeros(len(points), np.int64) if kinds is None else kinds
    number_cells(np.ascontiguousarray(points, np.float64), edges, kinds, AXIS_BITS, numbers)
    return numbers
