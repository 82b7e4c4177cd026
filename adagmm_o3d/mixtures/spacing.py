"""How far the points of a cloud are apart."""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cpu.nearest_other import nearest_other_sq
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.sampling import distinct_places, quantile, some_of

# How many points are asked for their nearest neighbour, and among how many at most.
PROBES, PROBED = 150, 20_000


def spacing_of(points: Array) -> float:
    """Median distance from one of (n, 3) points to its nearest neighbour in another place, from a few probes."""
    points = points[distinct_places(points)]
    probes = some_of(np.arange(len(points)), PROBES)
    squares = np.empty(len(probes))
    nearest_other_sq(np.ascontiguousarray(points.T), probes, squares)
    return math.sqrt(quantile(squares, 0.5))


def spacing_of_whole(mixture: Mixture) -> float:
    """The same of all points of a mixture.

    Of many only a part is looked at; the spacing of the whole, a surface (in 2D a curve), follows from that of the
    part.
    """

    def find() -> float:
        part = mixture.points_at(some_of(np.arange(len(mixture)), PROBED))
        return spacing_of(part) * (len(part) / len(mixture)) ** (1.0 / (mixture.dimension - 1))

    return mixture.kept_for("spacing", find)
