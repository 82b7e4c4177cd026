"""A few values in place of many: a random sample, the same one every time; the distinct places, and what is not alike;
and quantiles, each of which is one of the values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array


def some_of(index: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """At most `count` of (n,) indices, chosen at random with a fixed seed, in their order."""
    if len(index) <= count:
        return index
    return np.sort(np.random.default_rng(0).permutation(index)[:count])


def distinct_places(points: Array) -> NDArray[np.intp]:
    """The first index of each different one of (n, 3) points, in ascending order of the points."""
    order = np.lexsort(points.T[::-1])  # several times as fast as np.unique is along an axis
    ordered = points[order]
    another = np.full(len(points), True)
    another[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order[another]


def first_of_alike(alike: NDArray[np.bool_]) -> list[int]:
    """Indices of those that are not alike any that was taken before them; `alike` (n, n) says which two are."""
    taken: list[int] = []
    for k in range(len(alike)):
        if not alike[k, taken].any():
            taken.append(k)
    return taken


def quantile(values: Array, share: float) -> Array:
    """The value at place share·(n - 1), rounded down, of (n, …) `values` sorted on axis 0; a share of 0.5: a median."""
    k = int(share * (len(values) - 1))
    return np.partition(values, k, axis=0)[k]
