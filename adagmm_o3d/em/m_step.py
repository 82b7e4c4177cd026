"""The M-step: one Gauss-Newton step on Eq. 5 from the sums over all pairs.

Q is a quartic in (R, t) because the source's covariances turn with R; its gradient here is exact, the turning term
included. One step for every E-step (generalised EM) reaches the fixed points of the exact minimisation.
"""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array

# The free directions of a left perturbation δ = (ω, v): in the plane z = 0 the turn about z and the shifts in x and y.
FREE = {2: np.array([2, 3, 4]), 3: np.arange(6)}
# A direction this much softer than the stiffest one is not determined by the pairs and gets no step.
SOFT = 1e-9


def solve_step(hessian: Array, gradient: Array, dimension: int) -> Array:
    """(6,) δ = -H⁻¹ g on the free directions of the dimension."""
    free = FREE[dimension]
    values, vectors = np.linalg.eigh(hessian[np.ix_(free, free)])
    firm = values > SOFT * values[-1]
    inverse = np.where(firm, 1.0 / np.where(firm, values, 1.0), 0.0)
    delta = np.zeros(6)
    delta[free] = -vectors @ (inverse * (vectors.T @ gradient[free]))
    return delta
