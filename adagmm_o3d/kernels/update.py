"""What an iteration of EM makes of the sums over all pairs: the step, the next σ and share without a partner, the move.

There are two loops: `em.loop` in Python around passes over many pairs, and `cpu.em` compiled for many starts on few.
This is what both do between two passes. Nothing here is worth vector code, so it is compiled with exact arithmetic, and
both get the same bits.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.acceleration import (
    LOG_SIGMA,
    MEMORY,
    STATE,
    TURN_AND_SHIFT,
    UNMATCHED_SHARE,
    accelerated_step,
    forget,
    forget_compiled,
)
from adagmm_o3d.kernels.cpu.compiling import EXACT_FLAGS, EXACT_KERNEL_FLAGS, source_stamp
from adagmm_o3d.kernels.layout import GRADIENT, HESSIAN, TOTAL_ENERGY, TOTAL_MATCHED, TOTAL_WEIGHT

# A direction this much softer than the stiffest one is not determined by the pairs and gets no step.
SOFT = 1e-9
# σ has settled when it changes by less than this share of itself.
SIGMA_TOLERANCE = 0.01
# How a run of EM stands: it may go on, it has settled, or no pair has any weight.
STATES = MOVING, SETTLED, NO_OVERLAP = range(3)


class Rule(NamedTuple):
    """How σ and the share of points without a partner follow the pairs.

    dimension : 2 or 3.   floor : least σ.   fastest : the share of itself to which σ may fall in an iteration.
    follow : 1 keeps σ from falling below what the residuals say, 0 lets it fall whatever they say.
    least_unmatched, most_unmatched : bounds of the share.   accelerated : whether steps are extrapolated, see
    `acceleration`.
    """

    dimension: int
    floor: float
    fastest: float
    follow: float
    least_unmatched: float
    most_unmatched: float
    accelerated: bool


def fresh_memory(runs: int) -> NDArray[np.float64]:
    """(runs, rows, STATE) what `follow_pairs` keeps from one iteration to the next, with nothing in it."""
    memory = np.zeros((runs, 2 * MEMORY + 3, STATE))
    for one in memory:
        forget(one)
    return memory


@njit(**EXACT_FLAGS)
def solve(total, planar, axis, delta):
    """δ = -H⁻¹ g of `total` (layout.TOTAL_SUMS) on the free directions; whether the pairs determine all of these.

    Gauss and Jordan's elimination, the stiffest direction that is left each time. One that is not determined gets no
    step. `axis` (3,) is the only one to turn about, of unit length, or zero where any will do.
    """
    # In the plane z = 0 the turn about z and the shifts in x and y are free.
    n, first = (3, 2) if planar else (6, 0)
    upright = axis[0] != 0.0 or axis[1] != 0.0 or axis[2] != 0.0
    if upright:
        n, first = 4, 2
    rows = np.empty((n, n + 1))
    for i in range(n):
        for j in range(i, n):
            rows[i, j] = total[HESSIAN + _packed_index(first + i, first + j)]
            rows[j, i] = rows[i, j]
        rows[i, n] = -total[GRADIENT + first + i]
    if upright:
        _turn_about(total, axis, rows)
    for i in range(TURN_AND_SHIFT):
        delta[i] = 0.0
    taken = np.zeros(n, np.bool_)
    stiffest = 0.0
    for _ in range(n):
        k = -1
        for i in range(n):
            if not taken[i] and (k < 0 or rows[i, i] > rows[k, k]):
                k = i
        stiffest = max(stiffest, rows[k, k])
        if not rows[k, k] > SOFT * stiffest:
            break
        taken[k] = True
        for i in range(n):
            if i != k:
                share = rows[i, k] / rows[k, k]
                for j in range(n + 1):
                    rows[i, j] -= share * rows[k, j]
    determined = True
    for i in range(n):
        if taken[i]:
            delta[first + i] = rows[i, n] / rows[i, i]
        else:
            determined = False
    if upright:
        turn = delta[2]
        for i in range(3):
            delta[i] = turn * axis[i]
    return determined


@njit(**EXACT_FLAGS)
def _turn_about(total, axis, rows):
    """Make the first direction of `rows` (4, 5) the turn about `axis`; the others are the shifts."""
    rows[0, 0], rows[0, 4] = 0.0, 0.0
    for j in range(3):
        rows[0, 1 + j] = 0.0
    for i in range(3):
        rows[0, 4] -= axis[i] * total[GRADIENT + i]
        for j in range(3):
            rows[0, 0] += axis[i] * axis[j] * total[HESSIAN + _packed_index(min(i, j), max(i, j))]
            rows[0, 1 + j] += axis[i] * total[HESSIAN + _packed_index(i, 3 + j)]
    for j in range(3):
        rows[1 + j, 0] = rows[0, 1 + j]


@njit(**EXACT_FLAGS)
def _packed_index(i, j):
    """Where entry (i, j), i <= j, of a 6x6 matrix stands in its packed upper triangle."""
    return i * 6 - i * (i - 1) // 2 + j - i


@njit(**EXACT_FLAGS)
def m_step(total, planar, axis, relaxation, relative_rmse, sigma, delta):
    """`solve`, the step made longer by `relaxation`; whether the pairs determine it, and whether it is a short one: its
    square no more than `relative_rmse` of σ."""
    determined = solve(total, planar, axis, delta)
    moved = 0.0
    for i in range(TURN_AND_SHIFT):
        delta[i] *= relaxation
        moved += delta[i] * delta[i]
    return determined, moved <= relative_rmse * sigma


@njit(**EXACT_FLAGS)
def follow_pairs(total, delta, sigma, unmatched, rule, memory, step):
    """The σ and share of points without a partner that follow `sigma` and `unmatched`, and whether σ has settled.

    σ becomes what it would have to be for the residuals to look as the mixtures say.
    delta : (6,) the M-step's.   memory : one of `fresh_memory`.   step : (STATE,) receives the step to take.
    """
    energy = total[TOTAL_ENERGY] / total[TOTAL_WEIGHT]
    wanted = max(rule.follow * sigma * energy / rule.dimension, rule.floor)
    new = max(rule.fastest * sigma, wanted)
    settled = abs(new - sigma) < SIGMA_TOLERANCE * sigma
    residual = np.empty(STATE)
    for i in range(TURN_AND_SHIFT):
        residual[i] = delta[i]
    residual[LOG_SIGMA] = math.log(new / sigma)
    residual[UNMATCHED_SHARE] = _bounded(1.0 - total[TOTAL_MATCHED], rule) - unmatched
    if new > wanted or not rule.accelerated:
        forget_compiled(memory)
        for i in range(STATE):
            step[i] = residual[i]
    else:
        accelerated_step(residual, math.sqrt(sigma), memory, step)
        new = max(sigma * math.exp(step[LOG_SIGMA]), rule.floor)
    return new, _bounded(unmatched + step[UNMATCHED_SHARE], rule), settled


@njit(**EXACT_FLAGS)
def _bounded(unmatched, rule):
    return min(max(unmatched, rule.least_unmatched), rule.most_unmatched)


@njit(**EXACT_FLAGS)
def move(delta, pose):
    """`pose` (12,), the rows of [R | t], ← exp(ω) · pose, then + v; to second order in δ = (ω, v) the exponential of
    SE(3), and a rigid motion to rounding."""
    wx, wy, wz = delta[0], delta[1], delta[2]
    angle = math.sqrt(wx * wx + wy * wy + wz * wz)
    s = math.sin(angle) / angle if angle > 1e-8 else 1.0
    c = (1.0 - math.cos(angle)) / (angle * angle) if angle > 1e-4 else 0.5
    for column in range(4):
        x, y, z = pose[column], pose[4 + column], pose[8 + column]
        ax, ay, az = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        bx, by, bz = wy * az - wz * ay, wz * ax - wx * az, wx * ay - wy * ax
        pose[column] = x + s * ax + c * bx
        pose[4 + column] = y + s * ay + c * by
        pose[8 + column] = z + s * az + c * bz
    pose[3] += delta[3]
    pose[7] += delta[4]
    pose[11] += delta[5]


def density_without_partner(world: float, sigma: float, unmatched: float) -> float:
    """Density of the points without a partner, where they are a share `unmatched` of all, relative to that of a mixture
    at `sigma`; `world` is the same at σ = 1 for as many points with as without a partner."""
    return world / math.sqrt(sigma) * unmatched / (1.0 - unmatched)


density_without_partner_compiled = njit(**EXACT_FLAGS)(density_without_partner)


def _build(stamp):
    """The functions as called from Python; `stamp` keeps their cache fresh."""

    @njit(**EXACT_KERNEL_FLAGS)
    def call_m_step(total, planar, axis, relaxation, relative_rmse, sigma, delta):
        _ = stamp
        return m_step(total, planar, axis, relaxation, relative_rmse, sigma, delta)

    @njit(**EXACT_KERNEL_FLAGS)
    def call_follow_pairs(total, delta, sigma, unmatched, rule, memory, step):
        _ = stamp
        return follow_pairs(total, delta, sigma, unmatched, rule, memory, step)

    @njit(**EXACT_KERNEL_FLAGS)
    def call_move(delta, pose):
        _ = stamp
        move(delta, pose)

    return call_m_step, call_follow_pairs, call_move


call_m_step, call_follow_pairs, call_move = _build(source_stamp())
