"""What is believed of colours, estimated from the pairs as σ is: how far two looks at a place differ, and how many lie.

A pair's colours weigh a likelihood ratio: how probable their difference is if both points are the same place, to how
probable it is between points that have nothing to do with each other. A share of the colours lies (highlights, shadows,
what stood between) and says nothing. While the mixtures are wide a pair's points are far apart and so are their
colours: the estimated variance is large then and comes down with σ. So colour comes in as σ comes down, by itself.
"""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.unmatched import uniform_density
from adagmm_o3d.kernels.cpu.colour_moments import DENSITY, FIRST, MOMENTS, PER_COORDINATE, TRUE, colour_moments
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.merging import MergedMixture, sample
from adagmm_o3d.mixtures.mixture import PACKED, Mixture
from adagmm_o3d.sampling import some_of

# Source points whose pairs are looked at, target points among which, and pairs that have nothing to do with each other.
LOOKED_AT, AMONG, UNRELATED = 200, 20_000, 2000
# Largest squared Mahalanobis distance of a pair.
CUT = 16.0
# Before any pair is known: what two cameras make of the same place, on recordings of five sensors, and the share that
# lies.
DEVIATIONS, LYING = np.array([12.0, 8.0, 8.0]), 0.1
# No two looks at a place are more alike than this, and the share that lies is estimated within these bounds.
LEAST_DEVIATION, LEAST_LYING, MOST_LYING = 2.0, 0.02, 0.6
# A gain is estimated where a coordinate varies by so much and agrees so well, and within these bounds.
LEAST_VARIATION, LEAST_CORRELATION, GAINS = 4.0, 0.5, (0.4, 2.5)
# Rounds of estimation where nothing is known yet: the first takes every colour for true.
ROUNDS = 3


class ColourEstimate:
    """Estimates a `ColourModel` from the pairs of points, see `merging.sample`, of two mixtures that have colours."""

    def __init__(self, source: MergedMixture, target: MergedMixture) -> None:
        self._planar, self._dimension = source.dimension == 2, source.dimension
        source = source.take(some_of(np.arange(len(source.points)), LOOKED_AT))
        self._points, self._covariances, self._largest = source.points, source.covariances, source.largest_variances
        self._colours = _colours_of(source)
        self._axis = int(np.argmax(np.ptp(target.points, axis=0)))
        order = np.argsort(target.points[:, self._axis], kind="stable")
        self._others = target.points[order]
        self._other_covariances = target.covariances[order].reshape(-1, 9).take(PACKED, axis=1)
        self._other_largest = target.largest_variances[order]
        self._other_colours = _colours_of(target)[order]
        self._weights = target.weights[order] / target.weights.sum()
        rng = np.random.default_rng(0)
        self._unrelated = (
            self._colours[rng.integers(0, len(self._colours), UNRELATED)],
            self._other_colours[rng.integers(0, len(order), UNRELATED)],
        )

    def prior(self) -> ColourModel:
        """Before any pair is known."""
        return self._model(DEVIATIONS, np.ones(3), np.zeros(3), LYING)

    def first(self, pose: Array, sigma: float, unmatched: float) -> ColourModel:
        """From the pairs at a pose, of which nothing but the geometry is known."""
        model = self.next(None, pose, sigma, unmatched)
        for _ in range(ROUNDS - 1):
            model = self.next(model, pose, sigma, unmatched)
        return model

    def next(self, model: ColourModel | None, pose: Array, sigma: float, unmatched: float) -> ColourModel:
        """From the pairs at a pose, weighed by a model before; that model itself where no pair weighs anything."""
        moments = self._moments(model, pose, sigma)
        before = self.prior() if model is None else model
        # A density is that of the kernel times the share that lies, as its ratio is to that share.
        share = 1.0 if model is None else model.lying
        uniform = uniform_density(unmatched, sigma, self._dimension)
        weights = share / (share * moments[:, DENSITY] + uniform)
        total = weights @ moments
        if not total[TRUE] > 1e-12 * len(moments):
            return before
        lying = before.lying
        if model is not None:
            lying = float(min(max(1.0 - total[TRUE] / total[DENSITY], LEAST_LYING), MOST_LYING))
        mean_s, mean_t, ss, tt, st = total[FIRST:].reshape(3, PER_COORDINATE).T / total[TRUE]
        var_s, var_t, cov = ss - mean_s**2, tt - mean_t**2, st - mean_s * mean_t
        gain, offset = correction((mean_s, mean_t), (var_s, var_t), cov)
        residual = offset + gain * mean_s - mean_t
        variances = residual**2 + gain**2 * var_s - 2.0 * gain * cov + var_t
        deviations = np.sqrt(np.maximum(variances, LEAST_DEVIATION**2))
        return self._model(deviations, gain, offset, lying)

    def _model(self, deviations: Array, gain: Array, offset: Array, lying: float) -> ColourModel:
        own, other = self._unrelated
        half = 0.5 * (((gain * own + offset - other) / deviations) ** 2).sum(axis=1)
        odds = (1.0 - lying) / (lying * max(float(np.exp(-half).mean()), 1e-9))
        floor = max(math.log(odds), 0.0)
        return ColourModel(deviations, gain, offset, lying, floor, float(np.exp(-np.minimum(half, floor)).mean()))

    def _moments(self, model: ColourModel | None, pose: Array, sigma: float) -> Array:
        """(K, MOMENTS) of the source points that are looked at."""
        rotation = pose[:3, :3]
        points = np.ascontiguousarray(self._points @ rotation.T + pose[:3, 3])
        covariances = (sigma * rotation @ self._covariances @ rotation.T).reshape(-1, 9).take(PACKED, axis=1)
        largest, other_largest = sigma * self._largest, sigma * self._other_largest
        reach = np.sqrt(CUT * (largest + other_largest.max()))
        axis = np.ascontiguousarray(self._others[:, self._axis])
        windows = np.stack([np.searchsorted(axis, points[:, self._axis] + side * reach) for side in (-1.0, 1.0)])
        if model is None:
            known = np.ones(3), np.zeros(3), np.ones(3), 0.0
        else:
            known = model.gain, model.offset, model.deviations**-2.0, math.exp(model.floor)
        moments = np.empty((len(points), MOMENTS))
        colour_moments(
            (points, covariances, largest, self._colours),
            (self._others, sigma * self._other_covariances, other_largest, self._other_colours, self._weights),
            windows,
            self._planar,
            CUT,
            known,
            moments,
        )
        return moments


def correction(means: tuple[Array, Array], variances: tuple[Array, Array], covariances: Array) -> tuple[Array, Array]:
    """(3,) gain and offset that bring colours of the source's sensor to those of the target's, by their moments."""
    gain = np.array([_gain(*moments) for moments in zip(*variances, covariances, strict=True)])
    return gain, means[1] - gain * means[0]


def _gain(var_s: float, var_t: float, cov: float) -> float:
    """What a coordinate of the source's colours has to be multiplied with to vary as the target's: both err, so it is
    the ratio of their deviations."""
    least = LEAST_VARIATION**2
    if var_s < least or var_t < least or cov < LEAST_CORRELATION * math.sqrt(var_s * var_t):
        return 1.0
    return min(max(math.sqrt(var_t / var_s), GAINS[0]), GAINS[1])


def estimate_between(source: Mixture, target: Mixture) -> ColourEstimate | None:
    """The estimate between two normalised mixtures; None where one has no colours."""
    if source.colours is None or target.colours is None:
        return None
    return ColourEstimate(sample(source, LOOKED_AT), sample(target, AMONG))


def _colours_of(mixture: MergedMixture) -> Array:
    assert mixture.colours is not None
    return np.ascontiguousarray(mixture.colours)
