"""What stands for many values: a part of them, the same one every time, and quantiles that are points of the sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array


def some_of(index: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """At most `count` of (n,) indices, chosen at random with a fixed seed, in their order."""
    if len(index) <= count:
        return index
    return np.sort(np.random.default_rng(0).permutation(index)[:count])


def quantile(values: Array, share: float) -> Array:
    """The least of (n, …) `values` along the first axis that is no smaller than `share` of them; 0.5 is a median."""
    k = int(share * (len(values) - 1))
    return np.partition(values, k, axis=0)[k]
