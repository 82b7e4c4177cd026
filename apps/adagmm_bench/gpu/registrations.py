"""Whole registrations on the GPU and on the CPU, and from which size on a pass over all pairs is faster on the GPU."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from adagmm_bench.speed.large import surface_pair
from adagmm_o3d import PointRegistrationResult, TransformationEstimationForAdaptiveGMM, register_points
from adagmm_o3d.evaluation import rotation_error_deg
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.options import check_criteria
from adagmm_o3d.pairs.cpu_pairs import PairLoop
from adagmm_o3d.search.register import register_mixtures

SIZES = (1_000, 4_000, 30_000, 300_000)
CROSSING_SIZES = (250, 500, 1_000, 2_000, 4_000, 8_000)
CROSSING_SIGMA, CROSSING_UNIFORM = 0.05, 0.1


@dataclass(frozen=True)
class Timing:
    """Median seconds of a registration of `points` with as many, and its rotation error: on the CPU, on the GPU
    ("cuda"), and there with the clouds on the card beforehand ("resident")."""

    points: int
    seconds: dict[str, float]
    errors_deg: dict[str, float]


def registration_timings(sizes: tuple[int, ...], repeats: int) -> Iterator[Timing]:
    """Two samples of a surface, turned by 8 degrees, from the identity, with default options; compiled beforehand."""
    for points in sizes:
        problem = surface_pair(points)
        source, target = problem.source.points, problem.target.points
        on_card = cuda_arrays(source, target)
        ways: dict[str, Callable[[], PointRegistrationResult]] = {
            "resident": lambda on_card=on_card: register_resident(*on_card),
            "cuda": lambda source=source, target=target: register_points(source, target, device="cuda"),
            "cpu": lambda source=source, target=target: register_points(source, target, device="cpu"),
        }
        seconds, errors_deg = {}, {}
        for way, register in ways.items():
            T = register().transformation
            errors_deg[way] = float(rotation_error_deg(problem.T_target_source, T))
            seconds[way] = _median_seconds(register, repeats)
        yield Timing(points, seconds, errors_deg)


def cuda_arrays(*arrays: np.ndarray) -> list[Any]:
    """Copies on the card."""
    from adagmm_o3d.kernels.cuda.front_end import cuda

    return [cuda.to_device(array) for array in arrays]


def register_resident(source: Any, target: Any) -> PointRegistrationResult:
    """`register_points` with default options for arrays on the card."""
    from adagmm_o3d.mixtures.device_mixture import device_mixture

    clouds = [device_mixture(name, p, None, surface=False) for name, p in (("source", source), ("target", target))]
    options = TransformationEstimationForAdaptiveGMM()
    return register_mixtures(clouds[0], clouds[1], None, options, check_criteria(None), "cuda", None)


def crossing_point(repeats: int) -> int | None:
    """The least number of pairs among CROSSING_SIZES, squared, from which on the GPU's pass is the faster one."""
    from adagmm_o3d.pairs.cuda_pairs import CudaPairLoop

    crossing = None
    for points in CROSSING_SIZES:
        problem = surface_pair(points)
        clouds = (
            make_mixture("source", problem.source.points, None),
            make_mixture("target", problem.target.points, None),
        )
        source, target, _ = normalise(*clouds)
        seconds = []
        for loop in (PairLoop(source, target), CudaPairLoop(source, target)):

            def run(loop=loop):
                return loop.posterior_sums(np.eye(4), CROSSING_SIGMA, CROSSING_UNIFORM).energy

            run()
            seconds.append(_median_seconds(run, 5 * repeats))
        if seconds[1] >= seconds[0]:
            crossing = None
        elif crossing is None:
            crossing = points**2
    return crossing


def _median_seconds(run: Callable[[], object], repeats: int) -> float:
    seconds = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds))
