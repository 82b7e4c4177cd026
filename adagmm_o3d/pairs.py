"""What the loop asks of the pairs of two mixtures, whatever device evaluates them."""

from __future__ import annotations

from typing import Protocol

from .arguments import Array
from .kernels.pair_loop import PairSums, PosteriorSums


class Pairs(Protocol):
    """The pairs of a source and a target mixture; see `kernels.pair_loop.PairLoop`."""

    def sums(self, pose: Array, source_sigma: float, target_sigma: float) -> PairSums:
        """The paper's E-step."""

    def posterior_sums(self, pose: Array, sigma: float, uniform: float, mutuality: float = 0.0) -> PosteriorSums:
        """The E-step on convolved Gaussians."""

    def nearest_sq(self, pose: Array) -> Array:
        """Squared nearest distances."""
