"""The whole EM loop compiled, serial, for many starts on small mixtures.

One start is a few hundred thousand pairs in all: less than it would cost to come back to Python after every iteration.
Starts are independent of each other; see `ranges`.
"""

import math

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.acceleration import (
    LOG_SIGMA,
    MEMORY,
    STATE,
    TURN_AND_SHIFT,
    UNMATCHED_SHARE,
    accelerated_step,
    forget_compiled,
)
from adagmm_o3d.kernels.cpu.compiling import FLAGS, SERIAL_KERNEL_FLAGS, source_stamp
from adagmm_o3d.kernels.cpu.convolved_pass import ONE, ZERO, convolved_pass
from adagmm_o3d.kernels.cpu.convolved_rows import MATRIX, SHARE
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.layout import GRADIENT, TOTAL_ENERGY, TOTAL_MATCHED, TOTAL_SUMS, TOTAL_WEIGHT

# What is known of a start, one column each.
SIGMA, UNMATCHED, FASTEST, ITERATIONS, FOLLOW = range(5)
# What is kept of an iteration: the pose after it (12), then these.
HISTORY_SIGMA, HISTORY_ENERGY, HISTORY_MATCHED = 12, 13, 14
HISTORY_COLUMNS = 15
# What is known of where it ended.
END_SIGMA, END_UNMATCHED, END_LIKELIHOOD, END_ITERATIONS, END_SETTLED = range(5)
END_COLUMNS = 5


@njit(**FLAGS)
def solve(total, planar, delta):
    """δ = -H⁻¹ g by Cholesky, on the free directions; `total` as in layout. Undetermined directions get no step."""
    n = 3 if planar else 6
    first = 2 if planar else 0
    factor = np.empty((n, n), np.float64)
    trace = 0.0
    for i in range(n):
        trace += total[_packed_index(first + i, first + i)]
    for i in range(n):
        for j in range(i + 1):
            s = total[_packed_index(first + j, first + i)]
            for k in range(j):
                s -= factor[i, k] * factor[j, k]
            if i == j:
                factor[i, i] = math.sqrt(max(s + 1e-9 * trace, 1e-300))
            else:
                factor[i, j] = s / factor[j, j]
    for i in range(TURN_AND_SHIFT):
        delta[i] = 0.0
    for i in range(n):
        s = -total[GRADIENT + first + i]
        for k in range(i):
            s -= factor[i, k] * delta[first + k]
        delta[first + i] = s / factor[i, i]
    for i in range(n - 1, -1, -1):
        s = delta[first + i]
        for k in range(i + 1, n):
            s -= factor[k, i] * delta[first + k]
        delta[first + i] = s / factor[i, i]


@njit(**FLAGS)
def _packed_index(i, j):
    """Where entry (i, j), i <= j, of a 6x6 matrix stands in its packed upper triangle."""
    return i * 6 - i * (i - 1) // 2 + j - i


@njit(**FLAGS)
def move(delta, pose):
    """pose ← exp(ω) · pose, then + v; to second order in δ the exponential of SE(3), and a rigid motion to rounding."""
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


@njit(**FLAGS)
def at_scale(values, spreads, sigma, scaled, first):
    """σ · values + spreads, into the rows of `scaled` from `first` on."""
    for r in range(values.shape[0]):
        for i in range(values.shape[1]):
            scaled[first + r, i] = sigma * values[r, i] + spreads[r, i]


# Parts of their only callers: every compiled function that holds the loops over pairs takes seconds to compile.
@njit(inline="always", **FLAGS)
def one_pass(pose, sigma, uniform, source, target, kind, work, total):
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
        (own_packed, own_target_reach[0], bits),
        (tile_lo, tile_hi, tile_reach[0], bits, group_lo, group_hi, group_reach[0], bits),
        kind, uniform, 0.0, columns, total, densities,
    )  # fmt: skip


@njit(inline="always", **FLAGS)
def run_start(
    pose, start, source, target, kind, world, compared, bounds, relative_rmse, accelerated, bits, end, history
):
    """Run one start, serially; see `run_em`."""
    floor, least, greatest = bounds
    planar, isotropic = kind
    dimension = 2 if planar else 3
    m, n = source[0].shape[1], target[1].shape[1]
    all_bits = np.empty(max(m, n), np.float32)
    for i in range(len(all_bits)):
        all_bits[i] = bits
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
    residual, taken = np.empty(STATE, np.float64), np.empty(STATE, np.float64)
    memory = np.empty((2 * MEMORY + 3, STATE), np.float64)
    forget_compiled(memory)
    sigma, unmatched = start[SIGMA], start[UNMATCHED]
    iteration, still = 0, False
    while True:
        # The pass after the last step is for the likelihood; it has one place with the others to be called from, or the
        # loops over pairs would be compiled for each.
        ended = still or iteration == int(start[ITERATIONS])
        for i in range(12):
            pose32[i] = pose[i]
        uniform = world / math.sqrt(sigma) * unmatched / (1.0 - unmatched)
        one_pass(pose32, np.float32(sigma), uniform, source, target, (planar, isotropic, ended), work, total)
        if ended:
            break
        solve(total, planar, residual)
        energy = total[TOTAL_ENERGY] / (LOG2_SCALE * max(total[TOTAL_WEIGHT], 1e-300))
        wanted = max(start[FOLLOW] * sigma * energy / dimension, floor)
        new = max(start[FASTEST] * sigma, wanted)
        moved = 0.0
        for i in range(TURN_AND_SHIFT):
            moved += residual[i] * residual[i]
        still = moved <= relative_rmse * sigma and abs(new - sigma) < 0.01 * sigma
        residual[LOG_SIGMA] = math.log(new / sigma)
        residual[UNMATCHED_SHARE] = min(max(1.0 - total[TOTAL_MATCHED], least), greatest) - unmatched
        if new > wanted or not accelerated:
            forget_compiled(memory)
            for i in range(STATE):
                taken[i] = residual[i]
        else:
            accelerated_step(residual, math.sqrt(sigma), memory, taken)
            new = max(sigma * math.exp(taken[LOG_SIGMA]), floor)
        move(taken, pose)
        for i in range(12):
            history[iteration, i] = pose[i]
        history[iteration, HISTORY_SIGMA] = sigma
        history[iteration, HISTORY_ENERGY] = energy
        history[iteration, HISTORY_MATCHED] = total[TOTAL_MATCHED]
        unmatched = min(max(unmatched + taken[UNMATCHED_SHARE], least), greatest)
        sigma = new
        iteration += 1
    # The densities are relative to those of points without a partner, of which each end has its own share.
    uniform = world / math.sqrt(compared if compared > 0.0 else sigma) * unmatched / (1.0 - unmatched)
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
    end[END_SETTLED] = still


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def run_em(
        poses, starts, source, target, kind, world, compared, bounds, relative_rmse, accelerated, bits, ends, history
    ):
        """Run every start; `poses` (S, 12) move, `ends` (S, END_COLUMNS) tell where they came to.

        kind : (planar, isotropic).   world, compared : see `em.unmatched`.   bounds : (floor of σ, least,
        greatest unmatched share).   relative_rmse : a start is done when ‖δ‖² is below this share of σ and σ has
        settled.   accelerated : see `acceleration`.   bits : how far a weight may fall before its pair is left out.
        history : (S, most iterations, HISTORY_COLUMNS).
        """
        _ = stamp
        for s in range(starts.shape[0]):
            run_start(
                poses[s], starts[s], source, target, kind, world, compared, bounds, relative_rmse, accelerated, bits,
                ends[s], history[s],
            )  # fmt: skip

    return run_em


run_em = _build(source_stamp())
