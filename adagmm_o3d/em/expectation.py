"""The two E-steps: the paper's adaptive weights, and posteriors on convolved Gaussians (the default)."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.colour import ColourEstimate
from adagmm_o3d.em.m_step import moved
from adagmm_o3d.em.sigma_rules import Scale, SigmaRule
from adagmm_o3d.em.unmatched import uniform_density
from adagmm_o3d.kernels.cpu.acceleration import STATE
from adagmm_o3d.kernels.update import Rule, call_follow_pairs, fresh_memory
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.pairs.protocol import Pairs, PairSums, PosteriorSums

# The share of points without a partner is estimated within these bounds: never none, never nearly all.
LEAST_UNMATCHED, MOST_UNMATCHED = 0.05, 0.7
# On clouds of some thousand points σ follows the residuals down to 1 % of the radius, a fraction of their spacing.
# Below that it is chance how near the points of two samples lie (on recordings of five sensors poses got worse). Dense
# clouds tell more: there σ may follow to where float32 coordinates still have three digits.
SAMPLED_SIGMA, FINEST_SIGMA = 1e-4, 1e-6
# How fast σ may fall on all points: to this share of itself in an iteration.
FASTEST = 0.8
# What is believed of colours is estimated anew when the logarithm of σ has changed by more than this.
SAME_COLOURS = 0.1


class Expectation(Protocol):
    """An E-step with the scale it works at."""

    scale: Scale

    def e_step(self, pose: Array) -> PairSums:
        """All pairs weighed at `pose`."""

    def advance(self, pose: Array, delta: Array, sums: PairSums, settled: bool) -> tuple[Array, bool]:
        """Move `pose` along the M-step's `delta` and choose the next scale: the new pose, and whether the loop is done.

        `settled` says that the step was a short one.
        """

    def matched(self, sums: PairSums) -> float:
        """Estimated share of the source that has a partner."""


class AdaptiveExpectation:
    """The paper's: C of Eq. 5 for every pair, σ by a rule on nearest distances."""

    def __init__(self, pairs: Pairs, rule: SigmaRule, start: Array) -> None:
        self._pairs, self._rule = pairs, rule
        self.scale = rule.first(pairs, start)

    def e_step(self, pose: Array) -> PairSums:
        return self._pairs.sums(pose, self.scale.source, self.scale.target)

    def advance(self, pose: Array, delta: Array, sums: PairSums, settled: bool) -> tuple[Array, bool]:
        pose = moved(pose, delta)
        scale = self._rule.next(self._pairs, pose, self.scale, settled)
        self.scale = scale or self.scale
        return pose, scale is None

    def matched(self, sums: PairSums) -> float:
        """The paper's weights are no probabilities: the mean weight of a source point, relative to the largest."""
        return float(sums.row_weights.mean() / sums.row_weights.max())


def posterior_rule(
    dimension: int, *, fastest: float = FASTEST, floor: float = FINEST_SIGMA, accelerated: bool = True
) -> Rule:
    """How `PosteriorExpectation` lets σ and the share of points without a partner follow the pairs."""
    return Rule(dimension, floor, fastest, 1.0, LEAST_UNMATCHED, MOST_UNMATCHED, accelerated)


class PosteriorExpectation:
    """Every pair weighed by the probability, given both clouds, that its points are the same place.

    σ follows from the weights themselves: the mean squared Mahalanobis distance of the pairs, each by its weight, over
    the dimension is what σ would have to be for the residuals to look as the mixtures say (CPD's update of σ²). Points
    without a partner have no weight and do not hold it up, and it stops falling where the noise is. A fall by more than
    the factor `fastest` at once would cost basin, so it is bounded. The share of points without a partner is estimated
    from the same sums.
    """

    def __init__(
        self,
        pairs: Pairs,
        rule: Rule,
        sigma: float,
        *,
        unmatched: float,
        mutuality: float,
        colours: ColourEstimate | None = None,
    ) -> None:
        self._pairs, self._rule, self._mutuality = pairs, rule, mutuality
        self.scale = Scale(sigma, sigma)
        self.unmatched = unmatched
        self._memory = fresh_memory(1)[0]
        self._colours = colours
        self.colour: ColourModel | None = None
        self._colour_sigma = 0.0

    def e_step(self, pose: Array) -> PosteriorSums:
        self._look_at_colours(pose)
        return self._pairs.posterior_sums(pose, self.scale.target, self._uniform(), self._mutuality, self.colour)

    def advance(self, pose: Array, delta: Array, sums: PairSums, settled: bool) -> tuple[Array, bool]:
        step = np.empty(STATE)
        sigma, self.unmatched, still = call_follow_pairs(
            sums.total, delta, self.scale.target, self.unmatched, self._rule, self._memory, step
        )
        self.scale = Scale(sigma, sigma)
        return moved(pose, step), settled and still

    def matched(self, sums: PairSums) -> float:
        assert isinstance(sums, PosteriorSums)
        return sums.overlap

    def _look_at_colours(self, pose: Array) -> None:
        """Estimate anew what is believed of the colours, where σ is another one than when that was done."""
        sigma = self.scale.target
        if self._colours is None:
            return
        if self.colour is None:
            self.colour = self._colours.first(pose, sigma, self.unmatched)
        elif abs(math.log(sigma / self._colour_sigma)) < SAME_COLOURS:
            return
        else:
            self.colour = self._colours.next(self.colour, pose, sigma, self.unmatched)
        self._colour_sigma = sigma

    def _uniform(self) -> float:
        return uniform_density(self.unmatched, self.scale.target, self._rule.dimension)
