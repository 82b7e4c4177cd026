"""A part of many points, the same one every time."""

import numpy as np
from numpy.typing import NDArray


def some_of(index: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """At most `count` of (n,) indices, chosen at random with a fixed seed, in their order."""
    if len(index) <= count:
        return index
    return np.sort(np.random.default_rng(0).permutation(index)[:count])
