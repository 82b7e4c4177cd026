"""Coarse mixtures: many components merged into few, so that many starts can be tried for the price of one iteration."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arguments import Array
from .kernels.compiling import LOG2_SCALE
from .kernels.convolved_pass import pack
from .kernels.farthest_points import farthest_points
from .kernels.tiles import Float32, make_tiles, morton_order
from .mixture import PACKED, Mixture, largest_variances

# A cloud is thinned to this many points before it is merged; more say nothing about so few components.
MERGE_FROM = 4096
# A variance this many times that of a good point weighs nothing beside it: a pair's weight falls with its square root
# to the power of the dimension.
FLAGGED = 1e4
# Pairs are left out where their weight is below 2**-COARSE_BITS of what it would be without a distance between them: a
# coarse mixture says nothing so exactly.
COARSE_BITS = 12.0


@dataclass(frozen=True)
class MergedMixture:
    """Components of which each stands for many: its covariance at scale σ is σ · covariances + spreads.

    points (n, 3), covariances (n, 3, 3), spreads (n, 3, 3) the scatter of the points merged, weights (n,) summing to 1.
    """

    points: Array
    covariances: Array
    spreads: Array
    weights: Array
    dimension: int
    isotropic: bool = False

    def as_source(self, isotropic: bool) -> tuple[Any, ...]:
        """The components as `kernels.search` wants a source; `isotropic` says whether those of both sides are."""
        order, reach, reach_spreads, bits = self._reach
        matrices, spreads = self._matrices(isotropic)
        weights = self.weights[order]
        points = np.ascontiguousarray(self.points[order].T, np.float32)
        return points, matrices, spreads, weights, weights.astype(np.float32), reach[None], reach_spreads[None], bits

    def as_target(self, isotropic: bool) -> tuple[Any, ...]:
        """The components as `kernels.search` wants a target; `isotropic` says whether those of both sides are."""
        order, reach, reach_spreads, bits = self._reach
        matrices, spreads = self._matrices(isotropic)
        points = np.ascontiguousarray(self.points[order].T, np.float32)
        tiles = make_tiles(points, reach, bits)
        of_spreads = make_tiles(points, reach_spreads, bits)
        return (
            pack(points, self.weights[order], len(matrices)),
            matrices,
            spreads,
            reach[None],
            reach_spreads[None],
            bits,
            of_spreads.variance[None],
            of_spreads.group_variance[None],
            *tiles,
        )

    @cached_property
    def _reach(self) -> tuple[NDArray[np.intp], Float32, Float32, Float32]:
        """The order of the components in space; in that order, largest variances, those of the spreads, and bits."""
        n = len(self.points)
        order = morton_order(self.points, last=np.zeros(n, np.bool_))
        reach, reach_spreads = (
            (largest_variances(m[order], self.dimension, self.isotropic) / LOG2_SCALE).astype(np.float32)
            for m in (self.covariances, self.spreads)
        )
        return order, reach, reach_spreads, np.full(n, COARSE_BITS, np.float32)

    def _matrices(self, isotropic: bool) -> tuple[Float32, Float32]:
        """(1 or 6, n) packed covariances and spreads, in powers of two."""

        def packed(matrices: Array) -> Float32:
            if isotropic:
                return (matrices[self._reach[0], 0, 0][None] / LOG2_SCALE).astype(np.float32)
            rows = np.stack([matrices[self._reach[0], i, j] for i, j in PACKED]) / LOG2_SCALE
            if self.dimension == 2:
                rows[5] = 0.0
            return rows.astype(np.float32)

        return packed(self.covariances), packed(self.spreads)


def merge(mixture: Mixture, count: int) -> MergedMixture:
    """At most `count` components with the moments of those they stand for; vague ones are left out."""
    keep = _certain(mixture, MERGE_FROM)
    part = mixture.take(keep)
    points, covariances, weights = part.points, part.covariances, part.weights
    if len(points) <= count:
        return MergedMixture(
            points, covariances, np.zeros_like(covariances), weights / weights.sum(), mixture.dimension
        )
    label = np.empty(len(points), np.int64)
    farthest_points(np.ascontiguousarray(points.T), count, label)
    total = np.bincount(label, weights, count)
    used = total > 0

    def average(values: Array) -> Array:
        flat = values.reshape(len(values), -1)
        sums = np.stack([np.bincount(label, weights * column, count) for column in flat.T], axis=1)
        return (sums[used] / total[used, None]).reshape(-1, *values.shape[1:])

    means = average(points)
    offsets = points - means[np.cumsum(used)[label] - 1]
    spreads = average(offsets[:, :, None] * offsets[:, None, :])
    return MergedMixture(means, average(covariances), spreads, total[used] / total.sum(), mixture.dimension)


def sample(mixture: Mixture, count: int) -> MergedMixture:
    """At most `count` of the mixture's own components, chosen at random with a fixed seed; vague ones are left out."""
    part = mixture.take(_certain(mixture, count))
    return MergedMixture(
        part.points,
        part.covariances,
        np.zeros_like(part.covariances),
        part.weights / part.weights.sum(),
        mixture.dimension,
        mixture.isotropic,
    )


def _certain(mixture: Mixture, count: int) -> NDArray[np.intp]:
    """At most `count` indices of components that are not flagged as outliers."""
    keep = np.flatnonzero(mixture.variances() <= FLAGGED)
    if len(keep) > count:
        keep = np.sort(np.random.default_rng(0).permutation(keep)[:count])
    return keep
