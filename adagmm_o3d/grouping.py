"""Points that are merged: which of them go together, and what the groups have in common."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array

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
        self._order = np.argsort(labels, kind="stable")
        ordered = labels[self._order]
        self._first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
        self._weights = weights[self._order]

    def __len__(self) -> int:
        return len(self._first)

    @cached_property
    def total(self) -> Array:
        return np.add.reduceat(self._weights, self._first)

    def means(self, values: Array) -> Array:
        """(k, …) weighted means of (n, …) values of the points."""
        flat = values.reshape(len(values), -1)[self._order] * self._weights[:, None]
        return (np.add.reduceat(flat, self._first, axis=0) / self.total[:, None]).reshape(-1, *values.shape[1:])

    def each(self, values: Array) -> Array:
        """(n, …) for each point what (k, …) values say of its group."""
        spread = np.empty((len(self._order), *values.shape[1:]))
        sizes = np.diff(self._first, append=len(self._order))
        spread[self._order] = values.repeat(sizes, axis=0)
        return spread


def even_edge(points: Array) -> float | None:
    """The edge of even cells for (n, D) points: CELL times the root mean square distance from the centroid, or a half,
    a quarter of it; None where the cloud is not dense."""
    if len(points) < DENSE_FROM:
        return None
    edge = CELL * math.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())
    while edge > 0.0:
        cells = len(cells_of(points, edge))
        if cells > MOST_LEFT * len(points):
            break
        if cells >= FEWEST:
            return edge
        edge *= 0.5
    return None


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
    half = 1 << (AXIS_BITS - 1)
    places = np.floor(points / edges[:, None])
    apart = (np.abs(places) >= half).any(axis=1)
    numbers = np.zeros(len(points), np.int64) if kinds is None else kinds
    for axis in range(points.shape[1]):
        place = np.where(apart, 0.0, places[:, axis]).astype(np.int64) + half
        numbers = (numbers << AXIS_BITS) | place
    return np.where(apart, -1 - np.arange(len(points)), numbers)
