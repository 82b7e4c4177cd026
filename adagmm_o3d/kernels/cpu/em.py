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
from adagmm_o3d.kernels.cpu.convolved_pass import (
    ONE,
    ZERO,
    Kind,
    PassSource,
    PassSums,
    PassTarget,
    Weighing,
    convolved_pass,
)
from adagmm_o3d.kernels.cpu.tiles import Tiles
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

Float32 = NDArray[np.float32]

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
    likelihoods have in common.   axis : (3,) see `update.solve`.   isotropic : whether all covariances are multiples
    of the identity.   world : see `update.density_without_partner`.
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
    isotropic: bool
    world: float


class Runs(NamedTuple):
    """The starts of a call, one row each: poses (S, 12), which move; starts (S, 5), see FOLLOW; memories, see
    `update.fresh_memory`, with those of an end its run goes on as if it had not ended; ends (S, END_COLUMNS) tell where
    they came to; history (S, most iterations, HISTORY_COLUMNS)."""

    poses: NDArray[np.float64]
    starts: NDArray[np.float64]
    memories: NDArray[np.float64]
    ends: NDArray[np.float64]
    history: NDArray[np.float64]


class ScaledSource(NamedTuple):
    """The components of a source, whose covariance at scale σ is σ · covariances + spreads; float32, in powers of two.

    points (3, M), covariances and spreads (1 or 6, M) packed, weights (M,) float64 and weights32, reach and
    reach_spreads (1, M) the largest variances of either.
    """

    points: Float32
    covariances: Float32
    spreads: Float32
    weights: NDArray[np.float64]
    weights32: Float32
    reach: Float32
    reach_spreads: Float32


class ScaledTarget(NamedTuple):
    """The same of a target: `packed` as in `convolved_pass.pack`; the boxes (3, count) and largest variances (1, count)
    of its tiles and groups, see `tiles`."""

    packed: Float32
    covariances: Float32
    spreads: Float32
    reach: Float32
    reach_spreads: Float32
    tile_spreads: Float32
    group_spreads: Float32
    tile_lo: Float32
    tile_hi: Float32
    tile_variance: Float32
    group_lo: Float32
    group_hi: Float32
    group_variance: Float32


class Work(NamedTuple):
    """Room for both sides at some σ and pose, for what a pass leaves at the points of either and in all, and how far
    pairs reach."""

    pose: Float32
    matrices: Float32
    packed: Float32
    reach: Float32
    target_reach: Float32
    tile_reach: Float32
    group_reach: Float32
    columns: Float32
    densities: NDArray[np.float64]
    total: NDArray[np.float64]
    bits: Float32


# Parts of their only callers: every compiled function that holds the loops over pairs takes seconds to compile.
@njit(inline="always", **FLAGS)
def one_pass(pose, sigma, uniform, source, hues, target, kind, work):
    """All pairs at `pose`: fills the total, or where `kind` says densities only, the densities in `work`."""
    for i in range(12):
        work.pose[i] = pose[i]
    at_scale(source.covariances, source.spreads, sigma, work.matrices, 0)
    at_scale(target.covariances, target.spreads, sigma, work.packed, MATRIX)
    at_scale(source.reach, source.reach_spreads, sigma, work.reach, 0)
    at_scale(target.reach, target.reach_spreads, sigma, work.target_reach, 0)
    at_scale(target.tile_variance, target.tile_spreads, sigma, work.tile_reach, 0)
    at_scale(target.group_variance, target.group_spreads, sigma, work.group_reach, 0)
    convolved_pass(
        ZERO, ONE,
        PassSource(work.pose, source.points, work.matrices, source.weights, source.weights32, work.reach[0], work.bits),
        hues,
        PassTarget(
            work.packed, work.target_reach[0], work.bits,
            Tiles(
                target.tile_lo, target.tile_hi, work.tile_reach[0], work.bits,
                target.group_lo, target.group_hi, work.group_reach[0], work.bits,
            ),
        ),
        kind, Weighing(uniform, 0.0), PassSums(work.columns, work.total, work.densities),
    )  # fmt: skip


@njit(**FLAGS)
def leave_powers_of_two(total):
    """The sums as formulas have them: what is a precision, or linear in one, out of powers of two."""
    for i in range(TOTAL_WEIGHT):
        total[i] /= LOG2_SCALE
    total[TOTAL_ENERGY] /= LOG2_SCALE


@njit(inline="always", **FLAGS)
def run_start(s, runs, source, hues, target, limits):
    """Run start `s` of `runs`, serially; see `run_em`."""
    pose, start, memory, end, history = runs.poses[s], runs.starts[s], runs.memories[s], runs.ends[s], runs.history[s]
    planar, world = limits.dimension == 2, limits.world
    rule = Rule(
        limits.dimension, limits.floor, start[FASTEST], start[FOLLOW],
        limits.least_unmatched, limits.most_unmatched, limits.accelerated,
    )  # fmt: skip
    m, n = source.points.shape[1], target.covariances.shape[1]
    all_bits = np.empty(max(m, n), np.float32)
    for i in range(len(all_bits)):
        all_bits[i] = limits.bits
    total = np.empty(TOTAL_SUMS, np.float64)
    work = Work(
        np.empty(12, np.float32),
        np.empty((target.covariances.shape[0], m), np.float32),
        target.packed.copy(),
        np.empty((1, m), np.float32),
        np.empty((1, n), np.float32),
        np.empty((1, target.tile_spreads.shape[1]), np.float32),
        np.empty((1, target.group_spreads.shape[1]), np.float32),
        np.empty(target.packed.shape[1], np.float32),
        np.empty(m, np.float64),
        total,
        all_bits,
    )
    delta, step = np.empty(TURN_AND_SHIFT, np.float64), np.empty(STATE, np.float64)
    sigma, unmatched = start[SIGMA], start[UNMATCHED]
    iteration, state, determined = 0, MOVING, True
    while True:
        # The pass after the last step is for the likelihood; it has one place with the others to be called from, or the
        # loops over pairs would be compiled for each.
        ended = state != MOVING or iteration == int(start[ITERATIONS])
        kind = Kind(planar, limits.isotropic, ended)
        uniform = density_without_partner_compiled(world, sigma, unmatched)
        one_pass(pose, np.float32(sigma), uniform, source, hues, target, kind, work)
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
    for i in range(m):
        likelihood += source.weights[i] * math.log1p(work.densities[i] / uniform)
    shares = target.packed[SHARE]
    for i in range(n):
        likelihood += shares[i] * math.log1p(work.columns[i] / (shares[i] * uniform))
    end[END_SIGMA] = sigma
    end[END_UNMATCHED] = unmatched
    end[END_LIKELIHOOD] = likelihood
    end[END_ITERATIONS] = iteration
    end[END_STATE] = state
    end[END_DETERMINED] = determined


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def run_em(runs, source, hues, target, limits):
        """Run every start of `Runs` within `RunLimits`. source, target : `ScaledSource`, `ScaledTarget`.   hues : see
        `convolved_pass`."""
        _ = stamp
        for s in range(runs.starts.shape[0]):
            run_start(s, runs, source, hues, target, limits)

    return run_em


run_em = _build(source_stamp())
