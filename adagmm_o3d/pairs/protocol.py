"""What the loop asks of the pairs of two mixtures, whatever device evaluates them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.layout import GRADIENT, HESSIAN, TOTAL_ENERGY, TOTAL_MATCHED, TOTAL_WEIGHT
from adagmm_o3d.mixtures.colours import ColourModel

UPPER = np.triu_indices(6)


@dataclass(frozen=True)
class PairSums:
    """What one pass over all pairs leaves behind.

    total (layout.TOTAL_SUMS,) float64 is what the M-step needs; row_weights (M,) the sum of the weights of each source
    point.
    """

    total: Array
    row_weights: Array

    @property
    def hessian(self) -> Array:
        """(6, 6) of ½ Q (the paper's Eq. 5), the weights held, at a left perturbation exp(δ)·T with δ = (ω, v)."""
        matrix = np.empty((6, 6))
        matrix[UPPER] = self.total[HESSIAN:GRADIENT]
        matrix.T[UPPER] = matrix[UPPER]
        return matrix

    @property
    def gradient(self) -> Array:
        """(6,) of the same."""
        return self.total[GRADIENT:TOTAL_WEIGHT]

    @property
    def weight(self) -> float:
        """The sum of all weights."""
        return float(self.total[TOTAL_WEIGHT])

    @property
    def energy(self) -> float:
        """Q."""
        return float(self.total[TOTAL_ENERGY])


@dataclass(frozen=True)
class PosteriorSums(PairSums):
    """The same with weights that are posterior probabilities; row_weights are those of having a partner at all."""

    find_column_densities: Callable[[], Array]

    @property
    def overlap(self) -> float:
        """Share of the source that has a partner."""
        return float(self.total[TOTAL_MATCHED])

    @cached_property
    def column_densities(self) -> Array:
        """(N,) density of the source mixture at the target points, in the unit of `uniform`.

        Where mutuality did not need it, it takes a pass over the pairs, made when somebody asks.
        """
        return self.find_column_densities()


class Pairs(Protocol):
    """The pairs of a source and a target mixture; see `pairs.cpu_pairs.PairLoop`."""

    def sums(self, pose: Array, source_sigma: float, target_sigma: float) -> PairSums:
        """The paper's E-step."""

    def posterior_sums(
        self, pose: Array, sigma: float, uniform: float, mutuality: float = 0.0, colour: ColourModel | None = None
    ) -> PosteriorSums:
        """The E-step on convolved Gaussians; with a model of them, on those of the points' colours too."""

    def nearest_sq(self, pose: Array) -> Array:
        """Squared nearest distances."""
