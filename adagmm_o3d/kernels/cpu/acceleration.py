"""Anderson acceleration of EM: what the last steps did to the residual says where the steps are leading.

EM is a fixed-point iteration: pose, σ and the share of points without a partner go in and come out, changed by a
residual. Near the end it converges linearly, by a few per cent an iteration where surfaces slide along each other. The
step that would have brought the combination of the last residuals closest to zero goes most of the way at once.

Source
------
D. G. Anderson: Iterative Procedures for Nonlinear Integral Equations, J. ACM 12, 1965.   H. F. Walker, P. Ni: Anderson
Acceleration for Fixed-Point Iterations, SIAM J. Numer. Anal. 49, 2011.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.compiling import EXACT_FLAGS

# The state: ω, v, log σ, unmatched share.
TURN_AND_SHIFT, LOG_SIGMA, UNMATCHED_SHARE = 6, 6, 7
STATE = 8
# How many past steps are combined.
MEMORY = 3
# A step goes no further than this: in standard deviations of the mixtures, and in log σ.
LONGEST_STEP, LARGEST_CHANGE = 0.3, 0.2
RIDGE = 1e-10


def empty_memory() -> NDArray[np.float64]:
    """Work space of `accelerated_step`: differences of residuals and of states, the last residual and step, a count."""
    return np.zeros((2 * MEMORY + 3, STATE))


def forget(memory: NDArray[np.float64]) -> None:
    """Begin anew."""
    memory[-1, 0] = -1.0


# Python itself is quicker with it than Numba with compiling it in every process.
forget_compiled = njit(**EXACT_FLAGS)(forget)


@njit(**EXACT_FLAGS)
def accelerated_step(residual, deviation, memory, step):
    """The step (STATE,) to take at this `residual` (STATE,); `deviation` is the mixtures' √σ, the unit of a pose."""
    known = int(memory[-1, 0])
    last, taken = memory[-3], memory[-2]
    if known >= 0:
        # A residual that has grown comes from somewhere else: the past says nothing about it.
        if size(residual, deviation) > size(last, deviation):
            known = 0
        else:
            for i in range(STATE):
                for k in range(min(known, MEMORY - 1), 0, -1):
                    memory[k, i] = memory[k - 1, i]
                    memory[MEMORY + k, i] = memory[MEMORY + k - 1, i]
                memory[0, i] = residual[i] - last[i]
                memory[MEMORY, i] = taken[i]
            known = min(known + 1, MEMORY)
    else:
        known = 0
    factor, share = np.empty((MEMORY, MEMORY), np.float64), np.empty(MEMORY, np.float64)
    trace = 0.0
    for a in range(known):
        share[a] = product(memory[a], residual, deviation)
        trace += product(memory[a], memory[a], deviation)
    for a in range(known):
        for b in range(a + 1):
            s = product(memory[a], memory[b], deviation)
            for c in range(b):
                s -= factor[a, c] * factor[b, c]
            if a == b:
                factor[a, a] = math.sqrt(max(s, RIDGE * trace) + 1e-300)
            else:
                factor[a, b] = s / factor[b, b]
    for a in range(known):
        for c in range(a):
            share[a] -= factor[a, c] * share[c]
        share[a] /= factor[a, a]
    for a in range(known - 1, -1, -1):
        for c in range(a + 1, known):
            share[a] -= factor[c, a] * share[c]
        share[a] /= factor[a, a]
    for i in range(STATE):
        step[i] = residual[i]
        for a in range(known):
            step[i] -= share[a] * (memory[a, i] + memory[MEMORY + a, i])
    pose = 0.0
    for i in range(TURN_AND_SHIFT):
        pose += step[i] * step[i]
    excess = max(math.sqrt(pose) / (LONGEST_STEP * deviation), abs(step[LOG_SIGMA]) / LARGEST_CHANGE)
    if excess > 1.0:
        for i in range(STATE):
            step[i] /= excess
    for i in range(STATE):
        last[i], taken[i] = residual[i], step[i]
    memory[-1, 0] = known


@njit(**EXACT_FLAGS)
def product(a, b, deviation):
    """Inner product of two states, the pose in units of `deviation`."""
    pose = 0.0
    for i in range(TURN_AND_SHIFT):
        pose += a[i] * b[i]
    return pose / (deviation * deviation) + a[LOG_SIGMA] * b[LOG_SIGMA] + a[UNMATCHED_SHARE] * b[UNMATCHED_SHARE]


@njit(**EXACT_FLAGS)
def size(a, deviation):
    return math.sqrt(product(a, a, deviation))
