"""Points that are merged: which of them go together, and what the groups have in common."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array


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
