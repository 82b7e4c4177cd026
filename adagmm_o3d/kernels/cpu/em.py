"""The whole EM loop compiled, serial, for many starts on small mixtures.

One start is a few hundred thousand pairs in all: less than it would cost to come back to Python after every iteration.
Starts are independent of each other; see `ranges`.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.acceleration import STATE, TURN_AND_SHIFT
from adagmm_o3d.kernels.cpu.compiling import FLAGS, SERIAL_KERNEL_FLAGS, source_stamp
from adagmm_o3d.kernels.cpu.convolved_pass import ONE, ZERO, convolved_pass
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.layout import MATRIX, SHARE, TOTAL_ENERGY, TOTAL_MATCHED, TOTAL_SUMS, TOTAL_WEIGHT
from adagmm_o3d.kernels.update import (
    MOVING,
    NO_OVERLAP,
    SETTLED,
    Rule,
    density_without_partner_compiled,
    follow_pairs,
    m_step,
    move,
)

# What is known of a start, one column each.
SIGMA, UNMATCHED, FASTEST, ITERATIONS, FOLLOW = range(5)
# What is kept of an iteration: the pose after it (12), then these.
HISTORY_SIGMA, HISTORY_ENERGY, HISTORY_MATCHED = 12, 13, 14
HISTORY_COLUMNS = 15
# What is known of where it ended.
# Its state is one of update.STATES.
END_SIGMA, END_UNMATCHED, END_LIKELIHOOD, END_ITERATIONS, END_STATE, END_DETERMINED = range(6)
END_COLUMNS = 6


@njit(**FLAGS)
def at_scale(values, spreads, sigma, scaled, first):
    """σ · values + spreads, into the rows of `scaled` from `first` on."""
    for r in range(values.shape[0]):
        for i in range(values.shape[1]):
            scaled[first + r, i] = sigma * values[r, i] + spreads[r, i]


class RunLimits(NamedTuple):
    """What all starts of a call have in common.

    dimension : 2 or 3.   floor, least_unmatched, most_unmatched, accelerated : see `update.Rule`.   relative_rmse,
    relaxation : see `update.m_step`; a start is done when its step is short and σ has settled.   bits : how far a
    weight may fall before its pair is left out.   compared_at : the σ whose density of points without a partner the
    likelihoods have in common.   axis : (3,) see `update.solve`.
    """

    dimension: int
    floor: float
    least_unmatched: float
    most_unmatched: float
    relative_rmse: float
    relaxation: float
    accelerated: bool
    bits: float
    compared_at: float
    axis: NDArray[np.float64]


# Parts of their only callers: every compiled function that holds the loops over pairs takes seconds to compile.
@njit(inline="always", **FLAGS)
def one_pass(pose, sigma, uniform, source, hues, target, kind, work, total):
    """All pairs at `pose`: fills `total`, or where `kind` says densities only, the densities in `work`."""
    points, covariances, spreads, weights, weights32, reach, reach_spreads = source
    _, a, k, target_reach, target_reach_spreads, tile_spreads, group_spreads = target[:7]
    matrices, own_packed, own_reach, own_target_reach, tile_reach, group_reach, columns, densities, bits = work
    tile_lo, tile_hi, tile_variance, group_lo, group_hi, group_variance = target[7:]
    at_scale(covariances, spreads, sigma, matrices, 0)
    at_scale(a, k, sigma, own_packed, MATRIX)
    at_scale(reach, reach_spreads, sigma, own_reach, 0)
    at_scale(target_reach, target_reach_spreads, sigma, own_target_reach, 0)
    at_scale(tile_variance, tile_spreads, sigma, tile_reach, 0)
    at_scale(group_variance, group_spreads, sigma, group_reach, 0)
    convolved_pass(
        ZERO, ONE, pose,
        (points, matrices, weights, weights32, own_reach[0], bits),
        hues,
        (own_packed, own_target_reach[0], bits),
        (tile_lo, tile_hi, tile_reach[0], bits, group_lo, group_hi, group_reach[0], bits),
        kind, uniform, 0.0, columns, total, densities,
    )  # fmt: skip


@njit(**FLAGS)
def leave_powers_of_two(total):
    """The sums as formulas have them: what is a precision, or linear in one, out of powers of two."""
    for i in range(TOTAL_WEIGHT):
        total[i] /= LOG2_SCALE
    total[TOTAL_ENERGY] /= LOG2_SCALE


@njit(inline="always", **FLAGS)
def run_start(pose, start, source, hues, target, isotropic, world, limits, memory, end, history):
    """Run one start, serially; see `run_em`."""
    planar = limits.dimension == 2
    rule = Rule(
        limits.dimension, limits.floor, start[FASTEST], start[FOLLOW],
        limits.least_unmatched, limits.most_unmatched, limits.accelerated,
    )  # fmt: skip
    m, n = source[0].shape[1], target[1].shape[1]
    all_bits = np.empty(max(m, n), np.float32)
    for i in range(len(all_bits)):
        all_bits[i] = limits.bits
    columns, densities = np.empty(target[0].shape[1], np.float32), np.empty(m, np.float64)
    work = (
        np.empty((target[1].shape[0], m), np.float32),
        target[0].copy(),
        np.empty((1, m), np.float32),
        np.empty((1, n), np.float32),
        np.empty((1, target[5].shape[1]), np.float32),
        np.empty((1, target[6].shape[1]), np.float32),
        columns,
        densities,
        all_bits,
    )
    pose32 = np.empty(12, np.float32)
    total = np.empty(TOTAL_SUMS, np.float64)
    delta, step = np.empty(TURN_AND_SHIFT, np.float64), np.empty(STATE, np.float64)
    sigma, unmatched = start[SIGMA], start[UNMATCHED]
    iteration, state, determined = 0, MOVING, True
    while True:
        # The pass after the last step is for the likelihood; it has one place with the others to be called from, or the
        # loops over pairs would be compiled for each.
        ended = state != MOVING or iteration == int(start[ITERATIONS])
        for i in range(12):
            pose32[i] = pose[i]
        uniform = density_without_partner_compiled(world, sigma, unmatched)
        one_pass(pose32, np.float32(sigma), uniform, source, hues, target, (planar, isotropic, ended), work, total)
        if ended:
            break
        if not total[TOTAL_WEIGHT] > 0.0:
            state = NO_OVERLAP
            continue
        leave_powers_of_two(total)
        determined, short = m_step(total, planar, limits.axis, limits.relaxation, limits.relative_rmse, sigma, delta)
        history[iteration, HISTORY_SIGMA] = sigma
        history[iteration, HISTORY_ENERGY] = total[TOTAL_ENERGY] / total[TOTAL_WEIGHT]
        history[iteration, HISTORY_MATCHED] = total[TOTAL_MATCHED]
        sigma, unmatched, still = follow_pairs(total, delta, sigma, unmatched, rule, memory, step)
        move(step, pose)
        for i in range(12):
            history[iteration, i] = pose[i]
        if short and still:
            state = SETTLED
        iteration += 1
    # The densities are relative to those of points without a partner, of which each end has its own share.
    uniform = density_without_partner_compiled(world, limits.compared_at, unmatched)
    likelihood = 2.0 * math.log(unmatched)
    weights, packed = source[3], target[0]
    for i in range(m):
        likelihood += weights[i] * math.log1p(densities[i] / uniform)
    for i in range(n):
        likelihood += packed[SHARE, i] * math.log1p(columns[i] / (packed[SHARE, i] * uniform))
    end[END_SIGMA] = sigma
    end[END_UNMATCHED] = unmatched
    end[END_LIKELIHOOD] = likelihood
    end[END_ITERATIONS] = iteration
    end[END_STATE] = state
    end[END_DETERMINED] = determined


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def run_em(poses, starts, source, hues, target, isotropic, world, limits, memories, ends, history):
        """Run every start; `poses` (S, 12) move, `ends` (S, END_COLUMNS) tell where they came to.

        hues : see `convolved_pass`.   isotropic : whether all covariances are multiples of the identity.   world : see
        `update.density_without_partner`.   limits : `RunLimits`.   memories : (S, …) see `update.fresh_memory`; with
        those of an end its run goes on as if it had not ended.   history : (S, most iterations, HISTORY_COLUMNS).
        """
        _ = stamp
        for s in range(starts.shape[0]):
            run_start(
                poses[s], starts[s], source, hues, target, isotropic, world, limits, memories[s], ends[s], history[s]
            )  # fmt: skip

    return run_em


run_em = _build(source_stamp())
