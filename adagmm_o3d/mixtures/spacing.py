"""How far the points of a cloud are apart."""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cpu.nearest_other import nearest_other_sq
from adagmm_o3d.mixtures.sampling import quantile, some_of

# How many points are asked for their nearest neighbour.
PROBES = 150


def spacing_of(points: Array) -> float:
    """Median distance from one of (n, 3) points to its nearest neighbour, from a few probes."""
    probes = some_of(np.arange(len(points)), PROBES)
    squares = np.empty(len(probes))
    nearest_other_sq(np.ascontiguousarray(points.T), probes, squares)
    return math.sqrt(quantile(squares, 0.5))
