"""The M-step: one Gauss-Newton step on Eq. 5 from the sums over all pairs.

Q is a quartic in (R, t) because the source's covariances turn with R; its gradient here is exact, the turning term
included. One step for every E-step (generalised EM) reaches the fixed points of the exact minimisation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .arguments import Array

FREE = {2: np.array([2, 3, 4]), 3: np.arange(6)}
# A direction this much softer than the stiffest one is left free by the points, in unit-radius coordinates.
UNOBSERVABLE = 1e-7


@dataclass(frozen=True)
class Step:
    """A left perturbation δ = (ω, v), (6,), and the unit directions, (6,) each, in which it was not determined."""

    delta: Array
    unobservable: tuple[Array, ...]


def solve_step(hessian: NDArray, gradient: NDArray, dimension: int) -> Step:
    """δ = -H⁻¹ g on the free directions of the dimension, leaving undetermined ones alone."""
    free = FREE[dimension]
    h, g = hessian[np.ix_(free, free)], gradient[free]
    values, vectors = np.linalg.eigh(h)
    soft = values <= UNOBSERVABLE * values[-1]
    inverse = np.where(soft, 0.0, 1.0 / np.where(soft, 1.0, values))
    delta = np.zeros(6)
    delta[free] = -vectors @ (inverse * (vectors.T @ g))
    directions = []
    for k in np.flatnonzero(soft):
        direction = np.zeros(6)
        direction[free] = vectors[:, k]
        directions.append(direction)
    return Step(delta, tuple(directions))
