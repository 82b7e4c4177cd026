"""Pairs a second of each pair kernel by itself, every pair evaluated, timed by the card's own clock."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from adagmm_bench.gpu.operations import PAIR_OPERATIONS
from adagmm_o3d.mixtures.mixture import Mixture, make_mixture

POINTS = 32_768
SIGMA, UNIFORM, MUTUALITY = 100.0, 0.05, 0.5  # so wide that no tile may be left out
REPEATS = 20


@dataclass(frozen=True)
class Rate:
    """Pairs a second, the median over REPEATS launches."""

    kernel: str
    pairs: float

    @property
    def operations(self) -> float:
        """Floating-point operations a second, counted as in `operations.PAIR_OPERATIONS`."""
        return self.pairs * PAIR_OPERATIONS[self.kernel]


def pair_rates() -> list[Rate]:
    """Every pair kernel on POINTS x POINTS points in space; only where there is a GPU."""
    from adagmm_o3d.pairs.cuda_pairs import CudaPairLoop

    rates, pose = [], np.eye(4)
    for suffix, isotropic in (("", False), (" isotropic", True)):
        rng = np.random.default_rng(0)
        loop = CudaPairLoop(*(_mixture(rng, isotropic) for _ in range(2)))
        loop.sums(pose, SIGMA, SIGMA)
        seconds = {"adaptive": _median_seconds(lambda loop=loop: loop.launch_adaptive_rows(SIGMA, SIGMA))}
        loop.posterior_sums(pose, SIGMA, UNIFORM, MUTUALITY)
        seconds["convolved"] = _median_seconds(lambda loop=loop: loop.launch_convolved_rows(SIGMA, UNIFORM, MUTUALITY))
        seconds["columns"] = _median_seconds(lambda loop=loop: loop.launch_convolved_columns(SIGMA))
        rates += [Rate(f"{name}{suffix}", POINTS**2 / s) for name, s in seconds.items()]
    return rates


def _mixture(rng: np.random.Generator, isotropic: bool) -> Mixture:
    axes = rng.uniform(0.5, 2.0, (POINTS, 1 if isotropic else 3))
    return make_mixture("cloud", rng.normal(size=(POINTS, 3)), axes[:, :, None] * np.eye(3))


def _median_seconds(launch: Callable[[], None]) -> float:
    from numba import cuda

    launch()  # compiled
    milliseconds = []
    for _ in range(REPEATS):
        begin, end = cuda.event(), cuda.event()
        begin.record()
        launch()
        end.record()
        end.synchronize()
        milliseconds.append(begin.elapsed_time(end))
    return 1e-3 * float(np.median(milliseconds))
