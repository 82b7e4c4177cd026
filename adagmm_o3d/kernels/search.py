"""The whole EM loop compiled, serial and without culling, for many starts at once on small mixtures.

One start is a few hundred thousand pairs in all: less than it would cost to come back to Python after every iteration.
Starts run in parallel and independently of each other.
"""

import math

import numpy as np
from numba import njit, prange

from .compiling import F0, F1, FLAGS, KERNEL_FLAGS, LOG2_SCALE, formulas, source_stamp
from .convolution_sums import row_convolved, row_convolved_isotropic
from .layout import (
    DENSITY,
    GRADIENT,
    ROW_SUMS,
    TOTAL_ENERGY,
    TOTAL_LIKELIHOOD,
    TOTAL_MATCHED,
    TOTAL_SUMS,
    TOTAL_WEIGHT,
)
from .normal_equations import add_row

rotate_point, rotate_symmetric = formulas.rotate_point, formulas.rotate_symmetric

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
    factor = np.zeros((n, n))
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
    x = np.empty(n)
    for i in range(n):
        s = -total[GRADIENT + first + i]
        for k in range(i):
            s -= factor[i, k] * x[k]
        x[i] = s / factor[i, i]
    delta[:] = 0.0
    for i in range(n - 1, -1, -1):
        s = x[i]
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
def one_pass(pose, sigma, uniform, source, target, kind, work, total):
    """All pairs at `pose`: fills `total`; the likelihood in it is that of both clouds.

    kind : (planar, isotropic); isotropic also means that nothing has been merged.
    """
    planar, isotropic = kind
    points, covariances, spreads, weights = source
    x, a, k, share = target
    scaled, columns, factor, turned, y = work
    n_all = x.shape[1]
    for j in range(n_all):
        for i in range(1 if isotropic else 6):
            scaled[i, j] = sigma * a[i, j] + k[i, j]
    columns[:] = F0
    total[:] = 0.0
    row = np.zeros(ROW_SUMS)
    still = np.zeros(6, np.float32)
    for m in range(points.shape[1]):
        y[0], y[1], y[2] = rotate_point(pose, points[0, m], points[1, m], points[2, m])
        row[:] = 0.0
        if isotropic:
            row_convolved_isotropic(
                x[0], x[1], x[2], scaled[0], share, factor, planar,
                weights[m], y[0], y[1], y[2], sigma * covariances[0, m], columns, row,
            )  # fmt: skip
        else:
            turned[0], turned[1], turned[2], turned[3], turned[4], turned[5] = rotate_symmetric(
                pose,
                sigma * covariances[0, m] + spreads[0, m],
                sigma * covariances[1, m] + spreads[1, m],
                sigma * covariances[2, m] + spreads[2, m],
                sigma * covariances[3, m] + spreads[3, m],
                sigma * covariances[4, m] + spreads[4, m],
                sigma * covariances[5, m] + spreads[5, m],
            )
            if planar:
                turned[5] = F1
            row_convolved(
                x[0], x[1], x[2], scaled[0], scaled[1], scaled[2], scaled[3], scaled[4], scaled[5], share, factor,
                weights[m], y[0], y[1], y[2],
                turned[0], turned[1], turned[2], turned[3], turned[4], turned[5], columns, row,
            )  # fmt: skip
        posterior = 1.0 / (row[DENSITY] + uniform)
        total[TOTAL_LIKELIHOOD] += weights[m] * math.log1p(row[DENSITY] / uniform)
        total[TOTAL_MATCHED] += weights[m] * row[DENSITY] * posterior
        add_row(row, weights[m] * posterior, y[0], y[1], y[2], still, total)
    for j in range(n_all):
        total[TOTAL_LIKELIHOOD] += share[j] * math.log1p(columns[j] / (share[j] * uniform))


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def search(poses, starts, source, target, kind, world, bounds, step, ends, history):
        """Run every start; `poses` (S, 12) move, `ends` (S, END_COLUMNS) tell where they came to.

        world : density of a uniform mixture of all points.   bounds : (floor of σ, least, greatest unmatched share).
        step : a start is done when ‖δ‖ is below and σ has settled.   history : (S, most iterations, HISTORY_COLUMNS).
        """
        _ = stamp
        floor, least, greatest = bounds
        planar = kind[0]
        dimension = 2 if planar else 3
        n_all = target[0].shape[1]
        for s in prange(starts.shape[0]):
            pose = poses[s]
            pose32 = np.empty(12, np.float32)
            scaled = np.empty((6, n_all), np.float32)
            columns = np.empty(n_all, np.float32)
            factor = np.ones(n_all, np.float32)
            turned = np.empty(6, np.float32)
            y = np.empty(3, np.float32)
            work = (scaled, columns, factor, turned, y)
            total = np.empty(TOTAL_SUMS)
            delta = np.empty(6)
            sigma = starts[s, SIGMA]
            unmatched = starts[s, UNMATCHED]
            ends[s, END_ITERATIONS] = starts[s, ITERATIONS]
            ends[s, END_SETTLED] = 0.0
            for iteration in range(int(starts[s, ITERATIONS])):
                pose32[:] = pose
                uniform = world * unmatched / (1.0 - unmatched)
                one_pass(pose32, np.float32(sigma), uniform, source, target, kind, work, total)
                solve(total, planar, delta)
                move(delta, pose)
                energy = total[TOTAL_ENERGY] / (LOG2_SCALE * max(total[TOTAL_WEIGHT], 1e-300))
                history[s, iteration, :12] = pose
                history[s, iteration, HISTORY_SIGMA] = sigma
                history[s, iteration, HISTORY_ENERGY] = energy
                history[s, iteration, HISTORY_MATCHED] = total[TOTAL_MATCHED]
                observed = sigma * energy / dimension
                new = max(starts[s, FASTEST] * sigma, starts[s, FOLLOW] * observed, floor)
                unmatched = min(max(1.0 - total[TOTAL_MATCHED], least), greatest)
                moved = 0.0
                for i in range(6):
                    moved += delta[i] * delta[i]
                still = moved <= step * step and abs(new - sigma) < 0.01 * sigma
                sigma = new
                if still:
                    ends[s, END_ITERATIONS] = iteration + 1
                    ends[s, END_SETTLED] = 1.0
                    break
            pose32[:] = pose
            uniform = world * unmatched / (1.0 - unmatched)
            one_pass(pose32, np.float32(sigma), uniform, source, target, kind, work, total)
            ends[s, END_SIGMA] = sigma
            ends[s, END_UNMATCHED] = unmatched
            # the sums are relative to the uniform part, of which each end has its own
            ends[s, END_LIKELIHOOD] = total[TOTAL_LIKELIHOOD] + 2.0 * math.log(unmatched)

    return search


search = _build(source_stamp())
