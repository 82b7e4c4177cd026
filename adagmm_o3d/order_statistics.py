"""Quantiles that are points of the sample: what is asked for many times of small arrays, where NumPy's take long."""

from __future__ import annotations

import numpy as np

from .arguments import Array


def quantile(values: Array, share: float) -> Array:
    """The least of (n, …) `values` along the first axis that is no smaller than `share` of them; 0.5 is a median."""
    k = int(share * (len(values) - 1))
    return np.partition(values, k, axis=0)[k]
