"""What the loop asks of the pairs of two mixtures, whatever device evaluates them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

from adagmm_o3d.arguments import Array


@dataclass(frozen=True)
class PairSums:
    """What one pass over all pairs leaves behind.

    hessian (6, 6) and gradient (6,) belong to ½ Q (the paper's Eq. 5), the weights held, at a left perturbation
    exp(δ)·T with δ = (ω, v). energy is Q, weight the sum of all weights, row_weights (M,) that of each source point.
    """

    hessian: Array
    gradient: Array
    weight: float
    energy: float
    row_weights: Array


@dataclass(frozen=True)
class PosteriorSums(PairSums):
    """The same with weights that are posterior probabilities; row_weights are those of having a partner at all.

    overlap : share of the source that has a partner.
    """

    overlap: float
    find_column_densities: Callable[[], Array]

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

    def posterior_sums(self, pose: Array, sigma: float, uniform: float, mutuality: float = 0.0) -> PosteriorSums:
        """The E-step on convolved Gaussians."""

    def nearest_sq(self, pose: Array) -> Array:
        """Squared nearest distances."""
