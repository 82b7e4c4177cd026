"""The plane through the neighbours of a point, looked for in ever larger cells until there is one.

The nearest points of a spinning LiDAR's are on its own ring and make a line, whatever the surface; those in other cells
do not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.grouping import cells_of
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.principal import principal_axes, scatter_among

CHUNK = 65536
"""Points whose neighbourhoods are gathered at a time; bounds the memory."""

REACH, LEAST = 3.0, 6
"""A neighbourhood are the nearest cells within REACH edges of a point; LEAST of them make a plane."""

FULL = 4.0
"""A cell of fewer points counts less: at the edge of a surface's noise. One of more does not count more."""

LINE, ROUGH = 0.1, 0.2
"""A neighbourhood is a line, one ring, when its second variance is below that share of its largest. It is a plane when
its least is below that share of its second; what is no plane at any size is taken as the smallest that is no line."""


def find_planes(points: Array, queries: Array, edges: Sequence[float], most: int) -> tuple[Array, Array]:
    """Normals at the queries, and how the points about them vary.

    points, queries : (N, D), (K, D), D = 2 or 3.   edges : of the cells, the smallest first, in their unit.
    most : cells in a neighbourhood.

    Returns unit normals (K, D), zero where there is none, and variances (K, D) of the neighbourhoods, the least of them
    first: that along the normal.
    """
    normals, variances = np.zeros(queries.shape), np.zeros(queries.shape)
    left = np.arange(len(queries))
    for edge in edges:
        if len(left) == 0:
            break
        cells = cells_of(points, edge)
        thinned, weights = cells.means(points), np.minimum(cells.total, FULL)
        index = NeighborIndex(thinned)
        found = np.zeros(len(left), bool)
        for start in range(0, len(left), CHUNK):
            chosen = left[start : start + CHUNK]
            rows, squares = index.query(queries[chosen], most)
            scatters, near = scatter_among(
                thinned, rows, weights=weights, squares=squares, reach_sq=(REACH * edge) ** 2
            )
            spread, directions = principal_axes(scatters)
            wide = (near >= min(LEAST, most)) & (spread[:, 1] > LINE * spread[:, -1])
            flat = wide & (spread[:, 0] < ROUGH * spread[:, 1])
            taken = flat | (wide & ~normals[chosen].any(axis=1))
            normals[chosen[taken]] = directions[taken, :, 0]
            variances[chosen[taken]] = np.maximum(spread[taken], 0.0)
            found[start : start + CHUNK] = flat
        left = left[~found]
    return normals, variances
