"""Whole depth frames of 300 000 points, and how time grows from 1000 points to a million."""

from __future__ import annotations

import os
import sys

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.problem import Cloud, Prepared, Problem, prepare
from adagmm_bench.simulation import rotation_matrix
from adagmm_bench.speed.measurement import Measurement, cpu_seconds
from adagmm_o3d.errors import InputError

FRAME_POINTS = 300_000
SIZES = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
FRAME_GOAL = 1.5
MEMORY_GOAL_GB = 1.0
BYTES_OF_MAXRSS = 1 if sys.platform == "darwin" else 1024


def surface_pair(points: int) -> Problem:
    """Two samples with a millimetre of noise of one curved surface, 4 m wide; the source is turned by 8 degrees."""
    rng = np.random.default_rng(points)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_matrix(np.array([3.0, 6.0, -4.0])), (0.10, -0.05, 0.08)

    def sample() -> np.ndarray:
        x, y = rng.uniform(-2, 2, points), rng.uniform(-1.5, 1.5, points)
        z = 3 + 0.4 * np.sin(1.7 * x) * np.cos(2.3 * y) + 0.25 * np.sin(3.1 * x + 0.8 * y * y) + 0.3 * (np.abs(x) < 0.5)
        return np.column_stack([x, y, z]) + rng.normal(0.0, 0.001, (points, 3))

    covariances = np.broadcast_to(np.eye(3), (points, 3, 3))
    R, t = T[:3, :3], T[:3, 3]
    return Problem(f"{points} points", Cloud((sample() - t) @ R, covariances), Cloud(sample(), covariances), T)


def frames() -> list[Measurement]:
    """One cold pair of whole frames. Ours comes first, so that the peak of memory is its own."""
    prepared = prepare(surface_pair(FRAME_POINTS), "centroids")
    _compile()
    before = _resident_bytes()
    seconds = {"adagmm": _seconds("adagmm", prepared)}
    above = (_peak_bytes() - before) / 1e9
    lines = [Measurement("frames", "adagmm, memory above the inputs", above, "GB", goal=MEMORY_GOAL_GB)]
    if METHODS["small-gicp"].missing() is None:
        seconds["small-gicp"] = _seconds("small-gicp", prepared)
        cost = seconds["adagmm"] / seconds["small-gicp"]
        lines.append(Measurement("frames", "adagmm / small-gicp", cost, "×", cost=True, goal=FRAME_GOAL))
    return lines + [Measurement("frames", f"{name}, {FRAME_POINTS} points", s, "s") for name, s in seconds.items()]


def scaling() -> list[Measurement]:
    """Seconds at each size, and the exponent of a power law through the larger half of the sizes."""
    _compile()
    lines, seconds = [], []
    for size in SIZES:
        problem = surface_pair(size)
        prepared = prepare(problem, "centroids")
        seconds.append(_seconds("adagmm", prepared))
        lines.append(Measurement("scaling", f"adagmm, {size} points", seconds[-1], "s"))
    half = len(SIZES) // 2
    exponent = np.polyfit(np.log(SIZES[half:]), np.log(seconds[half:]), 1)[0]
    return [*lines, Measurement("scaling", f"exponent from {SIZES[half]} points on", float(exponent), "")]


def _compile() -> None:
    """Have all code compiled: small clouds run in another loop than large ones."""
    for size in SIZES[:2]:
        prepared = prepare(surface_pair(size), "centroids")
        METHODS["adagmm"](prepared.source, prepared.target)


def _seconds(name: str, prepared: Prepared) -> float:
    return cpu_seconds(lambda: METHODS[name](prepared.source, prepared.target))


def _peak_bytes() -> int:
    try:
        import resource
    except ImportError as error:
        raise InputError("sections: 'frames' needs to know its memory, which this system does not tell") from error
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * BYTES_OF_MAXRSS


def _resident_bytes() -> int:
    """What the process holds now; its peak so far where the system does not tell."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return _peak_bytes()
