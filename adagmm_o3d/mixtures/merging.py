"""Coarse mixtures: many components merged into few, so that many starts can be tried for the price of one iteration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.grouping import Groups
from adagmm_o3d.kernels.cpu.convolved_pass import pack
from adagmm_o3d.kernels.cpu.em import ScaledSource, ScaledTarget
from adagmm_o3d.kernels.cpu.farthest_points import farthest_points
from adagmm_o3d.kernels.cpu.tiles import find_corners, maxima, morton_order
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.layout import FACTOR, MATRIX
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.mixture import Mixture, packed
from adagmm_o3d.sampling import some_of

# A cloud is thinned to this many points before it is merged; more say nothing about so few components.
MERGE_FROM = 4096
# A variance this many times that of a good point weighs nothing beside it: a pair's weight falls with its square root
# to the power of the dimension.
FLAGGED = 1e4
# Pairs are left out where their weight is below 2**-COARSE_BITS of what it would be without a distance between them: a
# coarse mixture says nothing so exactly.
COARSE_BITS = 12.0


class Ordered(NamedTuple):
    """The components in space: their order, and in it points (3, n), packed covariances and spreads (6, n), largest
    variances and bounds on those of the spreads (2, n); matrices and variances in powers of two."""

    order: NDArray[np.intp]
    points: NDArray[np.float32]
    covariances: NDArray[np.float32]
    spreads: NDArray[np.float32]
    reach: NDArray[np.float32]


@dataclass(frozen=True)
class MergedMixture:
    """Components of which each stands for many: its covariance at scale σ is σ · covariances + spreads.

    points (n, 3), covariances (n, 3, 3), spreads (n, 3, 3) the scatter of the points merged, weights (n,) summing to 1,
    largest_variances (n,) no less than the largest eigenvalue of each covariance. colours (n, 3) where each component
    is a point and has one, else None.
    """

    points: Array
    covariances: Array
    spreads: Array
    weights: Array
    largest_variances: Array
    dimension: int
    isotropic: bool = False
    colours: Array | None = None

    def take(self, index: slice | NDArray[np.intp]) -> MergedMixture:
        """The mixture of some of the components."""
        weights = self.weights[index]
        return MergedMixture(
            self.points[index],
            self.covariances[index],
            self.spreads[index],
            weights / weights.sum(),
            self.largest_variances[index],
            self.dimension,
            self.isotropic,
            None if self.colours is None else self.colours[index],
        )

    def as_source(self, isotropic: bool) -> ScaledSource:
        """The components as a source; `isotropic` says whether those of both sides are."""
        return self._isotropic_source if isotropic else self._source

    def as_target(self, isotropic: bool, colour: ColourModel | None = None) -> ScaledTarget:
        """The components as a target; `isotropic` says whether those of both sides are."""
        target = self._isotropic_target if isotropic else self._target
        if colour is None:
            return target
        hues = self.hues(colour, of_source=False)
        padded = np.pad(hues, ((0, 0), (0, target.packed.shape[1] - hues.shape[1])))
        return target._replace(packed=np.concatenate([target.packed, padded]))

    def hues(self, colour: ColourModel, *, of_source: bool) -> NDArray[np.float32]:
        """(3, n) colours in the order of the components in space, see `colours.ColourModel.hues`."""
        assert self.colours is not None
        return colour.hues(self.colours[self._ordered.order], of_source=of_source)

    @cached_property
    def _source(self) -> ScaledSource:
        order, points, matrices, spreads, reach = self._ordered
        weights = self.weights[order]
        return ScaledSource(points, matrices, spreads, weights, weights.astype(np.float32), reach[:1], reach[1:])

    @cached_property
    def _target(self) -> ScaledTarget:
        order, points, matrices, spreads, reach = self._ordered
        boxes = find_corners(points)
        of_tiles, of_groups = maxima(reach)
        return ScaledTarget(
            packed=pack(points, self.weights[order], len(matrices)),
            covariances=matrices,
            spreads=spreads,
            reach=reach[:1],
            reach_spreads=reach[1:],
            tile_spreads=of_tiles[1:],
            group_spreads=of_groups[1:],
            tile_lo=boxes.lo,
            tile_hi=boxes.hi,
            tile_variance=of_tiles[:1],
            group_lo=boxes.group_lo,
            group_hi=boxes.group_hi,
            group_variance=of_groups[:1],
        )

    @cached_property
    def _isotropic_source(self) -> ScaledSource:
        """The same with the one entry of a matrix that multiples of the identity need."""
        source = self._source
        return source._replace(covariances=source.covariances[:1], spreads=source.spreads[:1])

    @cached_property
    def _isotropic_target(self) -> ScaledTarget:
        target = self._target
        packed = np.concatenate([target.packed[: MATRIX + 1], target.packed[FACTOR:]])
        return target._replace(packed=packed, covariances=target.covariances[:1], spreads=target.spreads[:1])

    @cached_property
    def _ordered(self) -> Ordered:
        order = morton_order(self.points)
        points = self.points.astype(np.float32).T.take(order, axis=1)
        covariances, spreads = packed(self.covariances, self.dimension), packed(self.spreads, self.dimension)
        reach = np.stack([self.largest_variances, spreads[0] + spreads[3] + spreads[5]])
        in_powers = ((values / LOG2_SCALE).astype(np.float32) for values in (covariances, spreads, reach))
        return Ordered(order, points, *(values.take(order, axis=1) for values in in_powers))


def merge(mixture: Mixture, count: int) -> MergedMixture:
    """At most `count` components with the moments of those they stand for; vague ones are left out."""
    return mixture.kept_for(("merge", count), lambda: _merged(mixture, count))


def _merged(mixture: Mixture, count: int) -> MergedMixture:
    part = mixture.take(_certain(mixture, MERGE_FROM))
    if len(part) <= count:
        return _as_it_is(part)
    points, weights = part.points, part.weights
    label = np.empty(len(points), np.int64)
    farthest_points(np.ascontiguousarray(points.T), count, label)
    groups = Groups(label, weights)
    means = groups.means(points)
    offsets = points - groups.each(means)
    spreads = groups.means(offsets[:, :, None] * offsets[:, None, :])
    shares = groups.total / groups.total.sum()
    covariances, largest = groups.means(part.covariances), groups.means(part.largest_variances)
    return MergedMixture(means, covariances, spreads, shares, largest, mixture.dimension)


def sample(mixture: Mixture, count: int) -> MergedMixture:
    """At most `count` of the mixture's own components, chosen at random with a fixed seed; vague ones are left out."""
    return mixture.kept_for(("sample", count), lambda: _as_it_is(mixture.take(_certain(mixture, count))))


def _as_it_is(mixture: Mixture) -> MergedMixture:
    """Each component standing for itself."""
    return MergedMixture(
        mixture.points,
        mixture.covariances,
        np.zeros_like(mixture.covariances),
        mixture.weights / mixture.weights.sum(),
        mixture.largest_variances,
        mixture.dimension,
        mixture.isotropic,
        mixture.colours,
    )


def count_certain(mixture: Mixture) -> int:
    """How many components are not flagged as outliers; all where every one is, as `_certain` has it."""
    return int((mixture.variances <= FLAGGED).sum()) or len(mixture)


def _certain(mixture: Mixture, count: int) -> NDArray[np.intp]:
    """At most `count` indices of components that are not flagged as outliers; of all where every one is."""
    keep = np.flatnonzero(mixture.variances <= FLAGGED)
    if len(keep) == 0:
        keep = np.arange(len(mixture))
    return some_of(keep, count)
