"""Whether two surfaces say the same where they meet: near the other cloud, a point should lie on its surface.

A right pose of two clouds that share a part brings most of what comes near the other cloud onto it, facing the same
way; a chance fit lies through it. How much that can be expected to be, of these samples and their noise, one half of a
cloud says of the other half.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.lie import se_inverse
from adagmm_o3d.mixtures.merging import MergedMixture
from adagmm_o3d.mixtures.sampling import quantile
from adagmm_o3d.mixtures.spacing import spacing_of
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.trust.normals import surface_normals

# Neighbours that a point's normal comes from.
NEIGHBORS = {2: 6, 3: 16}
# So many spacings of the points from the other cloud a point is near it, and so far from its surface it is on it; or so
# many radii, where that is more: as far as sensors are known to bend what they see.
NEAR, ON, BENT = 3.0, 0.5, 0.04
# At most so many times that of points that are said to be noisier than most.
VAGUEST = 2.5
# Normals are the same up to this cosine; where the scatter across the surface is more than this share of that along it,
# as with noise or in a tangle, there is no surface to face the same way.
SAME_WAY, FLAT = 0.85, 0.1

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Agreement:
    """share : of the points of both clouds, those on the other's surface.   relative : of those near it, in units of
    the same share between the halves of a cloud."""

    share: float
    relative: float


class Surface:
    """(n, 3) points of one cloud with their normals, looked at from the other's.

    vague : (n,) how many times as far off as others each may lie, by what is said of its noise; None of points alike.
    """

    def __init__(self, points: Array, dimension: int, vague: Array | None = None) -> None:
        self.points = np.ascontiguousarray(points)
        self.vague = np.ones(len(points)) if vague is None else vague
        self.dimension = dimension
        self.normals, scatter = surface_normals(self.points, dimension, NEIGHBORS[dimension])
        self.flat = scatter < FLAT
        self.spacing = spacing_of(self.points)
        self.index = NeighborIndex(self.points)

    def halves(self) -> tuple[Surface, Surface]:
        """Every other point, and the rest."""
        first, second = (Surface(self.points[part::2], self.dimension, self.vague[part::2]) for part in (0, 1))
        return first, second


def surfaces_of(source: MergedMixture, target: MergedMixture) -> tuple[Surface, Surface]:
    """Those of two mixtures of points; of what is said to be noisier than most, more is not expected."""
    typical = float(quantile(np.concatenate([source.largest_variances, target.largest_variances]), 0.5))
    first, second = (
        Surface(side.points, side.dimension, np.sqrt(np.clip(side.largest_variances / typical, 1.0, VAGUEST**2)))
        for side in (source, target)
    )
    return first, second


def agreement(source: Surface, target: Surface, pose: Array) -> Agreement:
    """How far two surfaces agree at a pose (4, 4)."""
    near, on = _near_and_on(source, target, pose)
    expected = min(_share_of(*_near_and_on(*surface.halves(), np.eye(4))) for surface in (source, target))
    return Agreement(float(on.mean()), _share_of(near, on) / max(expected, 1e-9))


def _share_of(near: Mask, on: Mask) -> float:
    return float(on.sum() / max(1, near.sum()))


def _near_and_on(source: Surface, target: Surface, pose: Array) -> tuple[Mask, Mask]:
    """Of each point of both clouds, whether it is near the other one, and whether it is on its surface."""
    sides = [near_and_on(source, target, pose), near_and_on(target, source, se_inverse(pose))]
    near, on = (np.concatenate(part) for part in zip(*sides, strict=True))
    return near, on


def near_and_on(own: Surface, other: Surface, pose: Array) -> tuple[Mask, Mask]:
    """The same of each point of one cloud, which a pose (4, 4) moves to the other."""
    spacing = max(own.spacing, other.spacing)
    moved, normals = own.points @ pose[:3, :3].T + pose[:3, 3], own.normals @ pose[:3, :3].T
    indices, squares = other.index.query(moved)
    nearest, near = indices[:, 0], squares[:, 0] < max(NEAR * spacing, 2.0 * BENT) ** 2
    off = np.abs(np.einsum("ni,ni->n", moved - other.points[nearest], other.normals[nearest]))
    same_way = np.abs(np.einsum("ni,ni->n", normals, other.normals[nearest])) > SAME_WAY
    same_way |= ~(own.flat & other.flat[nearest])
    vague = np.sqrt(0.5 * (own.vague**2 + other.vague[nearest] ** 2))
    return near, near & (off < vague * max(ON * spacing, BENT)) & same_way
