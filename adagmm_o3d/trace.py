"""The record of a registration: what each EM iteration did, on whatever level."""

from __future__ import annotations

from dataclasses import dataclass

from .arguments import Array


@dataclass(frozen=True)
class Iteration:
    """One EM iteration, in normalised coordinates.

    pose (4, 4) after it, σ during it, energy per unit of pair weight, share of the source matched, level (0 coarsest).
    """

    pose: Array
    sigma: float
    energy: float
    matched: float
    level: int = 0
