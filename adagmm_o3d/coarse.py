"""Coarse mixtures: many components merged into few, so that many starts can be tried for the price of one iteration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arguments import Array
from .kernels.farthest_points import farthest_points
from .mixture import Mixture

# A cloud is thinned to this many points before it is merged; more say nothing about so few components.
MERGE_FROM = 4096
# A variance this many times that of a good point weighs nothing beside it: a pair's weight falls with its square root
# to the power of the dimension.
FLAGGED = 1e4


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
