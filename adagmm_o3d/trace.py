"""The record of a registration: what each EM iteration did, on whatever level."""

from __future__ import annotations

from typing import NamedTuple

from .arguments import Array


class Iteration(NamedTuple):
    """One EM iteration, in normalised coordinates.

    pose (4, 4) after it, σ during it, energy per unit of pair weight, share of the source matched, level (0 coarsest).
    """

    pose: Array
    sigma: float
    energy: float
    matched: float
    level: int = 0
