"""Whether two surfaces say the same where they meet: what comes to lie where the other one goes on should be on it.

A right pose of two clouds that share a part brings most of what comes near the other cloud onto it, facing the same
way; what they do not share lies beyond the end of one of them. A chance fit lies through the other surface, and two
bodies that differ leave something beside it. How much can be expected to be on it, of these samples and their noise,
one half of a cloud says of the other half.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import inverse_of
from adagmm_o3d.mixtures.merging import MergedMixture
from adagmm_o3d.mixtures.spacing import spacing_of
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.sampling import quantile, some_of
from adagmm_o3d.trust.normals import normals_of

# So few points are no surface.
LEAST_POINTS = 30
# Neighbours that a point's normal comes from, itself among them.
NEIGHBORS = {2: 6, 3: 16}
# So many spacings of the points from the other cloud a point is near it, and so far from its surface it is on it; or so
# many radii, where that is more: as far as sensors are known to bend what they see.
NEAR, ON, BENT = 3.0, 0.5, 0.04
# At most so many times that of points that are said to be noisier than most.
VAGUEST = 2.5
# Normals are the same up to this cosine; where the scatter across the surface is more than this share of that along it,
# as with noise or in a tangle, there is no surface to face the same way.
SAME_WAY, FLAT = 0.85, 0.1
# A surface ends where the neighbours of a point are off to one side by more than this share of how far they reach: at a
# straight edge by 0.42 of it on average, amid sixteen random ones by an eighth.
ONE_SIDED = 0.3
# Of what goes on, halves of a cloud find no less than this to be on each other.
LEAST_HELD = 0.3
# What holds counts within these: as much as of a cloud's own halves, less what sensors bend, is no sign of more.
HELD = (0.05, 0.95)
# What most points are off is a standard deviation of so many times the median of that, and no less than this share of
# the spacing.
OF_MEDIAN, LEAST_OFF = 1.4826, 0.02

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Agreement:
    """share : of the points of both clouds, those on the other's surface.   held : of those where that goes on, in
    units of the same share between the halves of a cloud.   beyond : of those that are not on it, the share where it
    ends; 0 of none."""

    share: float
    held: float
    beyond: float


class Surface:
    """(n, 3) points of one cloud with their normals, looked at from the other's.

    vague : (n,) how many times as far off as others each may lie, by what is said of its noise; None of points alike.
    """

    def __init__(self, points: Array, dimension: int, vague: Array | None = None) -> None:
        self.points = np.ascontiguousarray(points)
        self.vague = np.ones(len(points)) if vague is None else vague
        self.dimension = dimension
        self.index = NeighborIndex(self.points)
        self.spacing = spacing_of(self.points)
        indices, squares = self.index.query(self.points, NEIGHBORS[dimension] + 1)
        variances, self.normals = normals_of(self.points[:, :dimension], indices[:, :-1])
        self.flat = variances[:, 0] < FLAT * np.maximum(variances[:, 1], 1e-300)
        one_sided = self.points[indices[:, 1:]].mean(axis=1) - self.points
        self.ends = (one_sided**2).sum(axis=1) > ONE_SIDED**2 * squares[:, -1]

    @cached_property
    def expected(self) -> float:
        """Of the points of its halves that lie where the other goes on, those on it."""
        first, second = (Surface(self.points[part::2], self.dimension, self.vague[part::2]) for part in (0, 1))
        on, at_end = _meeting(first, second, np.eye(4))
        return max(_held(on, at_end), LEAST_HELD)

    def beside(self, points: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Of (n, 3) points: which of its own is nearest, its squared distance, and how far off the surface they are."""
        indices, squares = self.index.query(points)
        nearest = indices[:, 0]
        off = np.abs(np.einsum("ni,ni->n", points - self.points[nearest], self.normals[nearest]))
        return nearest, squares[:, 0], off

    def some(self, count: int) -> Surface:
        """At most so many of its points, to be looked at from another surface; what is known of them stays."""
        part = Surface.__new__(Surface)
        index = some_of(np.arange(len(self.points)), count)
        kept = {name: getattr(self, name)[index] for name in ("points", "normals", "flat", "vague")}
        part.__dict__.update(kept, spacing=self.spacing, dimension=self.dimension)
        return part

    def reflected(self, reflection: Array) -> Surface:
        """The surface under a (3, 3) reflection, which changes nothing in what is known of it."""
        image = Surface.__new__(Surface)
        image.__dict__.update(self.__dict__, points=self.points @ reflection, normals=self.normals @ reflection)
        image.index = NeighborIndex(image.points)
        return image


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
    on, at_end = _meeting(source, target, pose)
    return Agreement(
        share=float(on.mean()),
        held=_held(on, at_end) / min(source.expected, target.expected),
        beyond=float(at_end[~on].mean()) if not on.all() else 0.0,
    )


def log_held(held: float) -> float:
    """The logarithm of what holds, within HELD."""
    return math.log(min(max(held, HELD[0]), HELD[1]))


def held_and_share(own: Surface, other: Surface, pose: Array) -> tuple[float, float]:
    """Of the points of one surface that a pose (4, 4) moves to where the other goes on, the share that is on it; and of
    all, the share that is."""
    on, at_end = _meets(own, other, pose)
    return _held(on, at_end), float(on.mean())


def typical_off(off: Array, spacing: float) -> float:
    """The standard deviation of how far (n,) points are off, of clouds of that spacing."""
    return max(OF_MEDIAN * float(np.median(np.abs(off))), LEAST_OFF * spacing)


def _held(on: Mask, at_end: Mask) -> float:
    return float((on & ~at_end).sum() / max(1, (~at_end).sum()))


def _meeting(source: Surface, target: Surface, pose: Array) -> tuple[Mask, Mask]:
    """Of each point of both clouds, whether it is on the other's surface, and whether it is nearest to an end of it."""
    sides = [_meets(source, target, pose), _meets(target, source, inverse_of(pose))]
    on, at_end = (np.concatenate(part) for part in zip(*sides, strict=True))
    return on, at_end


def _meets(own: Surface, other: Surface, pose: Array) -> tuple[Mask, Mask]:
    """The same of each point of one cloud, which a pose (4, 4) moves to the other."""
    spacing = max(own.spacing, other.spacing)
    moved, normals = own.points @ pose[:3, :3].T + pose[:3, 3], own.normals @ pose[:3, :3].T
    nearest, squares, off = other.beside(moved)
    near = squares < max(NEAR * spacing, 2.0 * BENT) ** 2
    same_way = np.abs(np.einsum("ni,ni->n", normals, other.normals[nearest])) > SAME_WAY
    same_way |= ~(own.flat & other.flat[nearest])
    vague = np.sqrt(0.5 * (own.vague**2 + other.vague[nearest] ** 2))
    return near & (off < vague * max(ON * spacing, BENT)) & same_way, other.ends[nearest]
