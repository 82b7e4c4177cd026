"""The M-step: one Gauss-Newton step on Eq. 5 from the sums over all pairs.

Q is a quartic in (R, t) because the source's covariances turn with R; its gradient here is exact, the turning term
included. One step for every E-step (generalised EM) reaches the fixed points of the exact minimisation.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.update import call_m_step, call_move

# The free directions of a left perturbation δ = (ω, v): in the plane z = 0 the turn about z and the shifts in x and y.
FREE = {2: np.array([2, 3, 4]), 3: np.arange(6)}
# In place of the one axis to turn about: any will do.
ANY_AXIS = np.zeros(3)


class Step(NamedTuple):
    """delta : (6,) δ = (ω, v), 0 in directions that are not free or not determined.   determined : whether the pairs
    determine all free ones.   short : whether it is too short to change the residual."""

    delta: Array
    determined: bool
    short: bool


def solve_step(
    total: Array, dimension: int, *, relaxation: float, relative_rmse: float, sigma: float, axis: Array = ANY_AXIS
) -> Step:
    """-H⁻¹ g of the sums (layout.TOTAL_SUMS) on the free directions of the dimension, times `relaxation`.

    `axis` (3,) is the only one to turn about, zero where any will do. A step is short if it is no longer than
    √relative_rmse standard deviations of the mixtures at `sigma`.
    """
    delta = np.empty(6)
    return Step(delta, *call_m_step(total, dimension == 2, axis, float(relaxation), relative_rmse, sigma, delta))


def moved(pose: Array, delta: Array) -> Array:
    """`pose` (4, 4) turned by the first half of δ and then shifted by the second; see `kernels.update.move`."""
    rows = pose[:3].flatten()
    call_move(delta, rows)
    new = pose.copy()
    new[:3] = rows.reshape(3, 4)
    return new


def turned_about(axis: Array, pose: Array) -> Array:
    """`pose` (4, 4) with the turn about `axis` (3,) that is nearest to its rotation."""
    rotation = pose[:3, :3]
    cosine = np.trace(rotation) - axis @ rotation @ axis
    sine = axis @ (rotation[[2, 0, 1], [1, 2, 0]] - rotation[[1, 2, 0], [2, 0, 1]])
    delta = np.zeros(6)
    delta[:3] = math.atan2(sine, cosine) * axis
    new = moved(np.eye(4), delta)
    new[:3, 3] = pose[:3, 3]
    return new
