"""Where a surface ends: whether what two clouds do not share lies beyond the end of one of them, as of two parts, or
beside a surface that goes on, as of two bodies that differ."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.lie import se_inverse
from adagmm_o3d.trust.agreement import NEIGHBORS, Surface, near_and_on

# At a straight edge the neighbours of a point are off to one side, on average by 0.42 of how far they reach; amid
# sixteen random ones by an eighth of it.
ONE_SIDED = 0.3


def share_beyond_edges(source: Surface, target: Surface, pose: Array) -> float:
    """Of the points of both clouds that at a pose (4, 4) do not lie on the other's surface, the share that is nearest
    to an edge of it; 0 of none."""
    beyond = []
    for own, other, motion in ((source, target, pose), (target, source, se_inverse(pose))):
        on = near_and_on(own, other, motion)[1]
        rest = own.points[~on] @ motion[:3, :3].T + motion[:3, 3]
        beyond.append(_is_edge(other)[other.index.query(rest)[0][:, 0]] if len(rest) else np.empty(0, bool))
    return float(np.concatenate(beyond).mean()) if sum(map(len, beyond)) else 0.0


def _is_edge(surface: Surface) -> NDArray[np.bool_]:
    """(n,) whether a surface, or a curve in the plane, ends at a point."""
    indices, squares = surface.index.query(surface.points, NEIGHBORS[surface.dimension] + 1)
    offsets = surface.points[indices[:, 1:]].mean(axis=1) - surface.points
    return (offsets**2).sum(axis=1) > ONE_SIDED**2 * squares[:, -1]
