"""How σ, the scale of both mixtures, follows the distances between the clouds: the paper's two rules and annealing.

σ multiplies covariances of unit scale in normalised coordinates (see `normalisation.normalise`). A rule is asked once
before the first iteration and once after each; it answers with the next scale or, when the loop is done, with None.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.pairs.protocol import Pairs

# Identical clouds have no distances; float32 coordinates mean nothing below this (a standard deviation of 3e-5).
LEAST_SIGMA = 1e-9


class Scale(NamedTuple):
    """What the covariances of the source and of the target are multiplied with."""

    source: float
    target: float


class SigmaRule(Protocol):
    """One way to choose σ."""

    def first(self, pairs: Pairs, pose: Array) -> Scale:
        """The scale of the first iteration."""

    def next(self, pairs: Pairs, pose: Array, scale: Scale, settled: bool) -> Scale | None:
        """The scale after an iteration; `settled` when the pose has stopped moving at this one."""


@dataclass(frozen=True)
class FigureTwo:
    """The paper's Figure 2 to the letter: σ is the mean distance from a source point to its nearest target point, and
    scales the source's covariances alone."""

    def first(self, pairs: Pairs, pose: Array) -> Scale:
        return Scale(max(LEAST_SIGMA, float(np.sqrt(pairs.nearest_sq(pose)).mean())), 1.0)

    def next(self, pairs: Pairs, pose: Array, scale: Scale, settled: bool) -> Scale | None:
        return None if settled else self.first(pairs, pose)


@dataclass(frozen=True)
class NearestDistance:
    """The rule that reproduces the paper's published accuracy: σ is the mean squared distance from a source point to
    its nearest target point over the dimension, and scales both clouds' covariances."""

    dimension: int

    def first(self, pairs: Pairs, pose: Array) -> Scale:
        sigma = max(LEAST_SIGMA, float(pairs.nearest_sq(pose).mean()) / self.dimension)
        return Scale(sigma, sigma)

    def next(self, pairs: Pairs, pose: Array, scale: Scale, settled: bool) -> Scale | None:
        return None if settled else self.first(pairs, pose)


@dataclass
class Annealed:
    """`NearestDistance` until it settles, for its wide basin; then σ shrinks by `factor` whenever the pose has settled
    or `patience` iterations have passed, down to `floor`: the accuracy that points without a partner take away."""

    dimension: int
    factor: float = 0.8
    floor: float = 2.5e-4
    patience: int = 4
    _waited: int | None = None

    def first(self, pairs: Pairs, pose: Array) -> Scale:
        return NearestDistance(self.dimension).first(pairs, pose)

    def next(self, pairs: Pairs, pose: Array, scale: Scale, settled: bool) -> Scale | None:
        if self._waited is None:
            if not settled:
                return self.first(pairs, pose)
            self._waited = self.patience
        self._waited += 1
        if not settled and self._waited < self.patience:
            return scale
        if scale.target <= self.floor:
            return None if settled else scale
        self._waited = 0
        sigma = max(self.floor, scale.target * self.factor)
        return Scale(sigma, sigma)
