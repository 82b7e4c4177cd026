"""One method on one pair, as a record that goes into the journal."""

from __future__ import annotations

import time
from functools import cache

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.methods.ours import register_clouds
from adagmm_bench.pairs.problem import PairClouds, PairSource, plain_pair
from adagmm_bench.speed.large import surface_pair
from adagmm_bench.trial import TrialJob, attempt, orthonormal, record_of
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import overlap_ratio, rotation_error_deg
from adagmm_o3d.trust.verdict import signs

# Points on a grid of 0.04 units nearer than 0.06 are partners: this is the overlap that a pose has, ours or the truth.
OVERLAP_GRID, OVERLAP_DISTANCE = 0.04, 0.06


def run_pair_trial(job: TrialJob[PairSource]) -> dict:
    """Register a pair and judge. A method that raises is a record too, with the identity for a pose.

    The errors are a rotation in degrees and the displacement of the pair's centre in units; None without a truth. Ours
    add what they say of themselves: `overlap`, `warnings`, `belief` and the `signs` it comes from; and the CPU seconds
    until the pose was there, `pose_cpu_seconds`, as peers say nothing more.
    """
    method = METHODS[job.method]
    if (reason := method.missing()) is not None:
        raise InputError(f"{job.method} {reason} on this worker")
    clouds = job.problem.load()
    _warm_up(job.method)
    found, outcome = attempt(lambda: register_pair(job.method, clouds))
    T = np.eye(4) if found is None else orthonormal(found)
    return record_of(
        job,
        method.version(),
        **outcome,
        T_target_source=T.tolist(),
        unit=clouds.unit,
        centre=clouds.centre.tolist(),
        limits=list(clouds.limits),
        **_judged(clouds, T),
    )


def register_pair(name: str, clouds: PairClouds) -> tuple[np.ndarray, dict]:
    """The pose (4, 4) that a method finds, and what ours say of it."""
    if not METHODS[name].ours:
        T = np.array(METHODS[name](*clouds.for_peers()), dtype=float)
        T[:3, 3] *= clouds.unit
        return T, {}
    started = time.process_time()
    result = register_clouds(
        name,
        clouds.source,
        clouds.target,
        0.1 * clouds.unit,
        init=clouds.init,
        source_viewpoint=clouds.source_viewpoint,
        target_viewpoint=clouds.target_viewpoint,
    )
    pose_seconds = time.process_time() - started
    verdict = result.weigh()
    return result.transformation, {
        "pose_cpu_seconds": pose_seconds,
        "overlap": result.overlap,
        "warnings": list(result.warnings),
        "belief": result.belief,
        "signs": None if verdict is None or verdict.belief is None else signs(verdict).tolist(),
    }


def pose_difference(T_true: np.ndarray, T: np.ndarray, centre: np.ndarray, unit: float) -> tuple[float, float]:
    """Between two poses: degrees, and how far apart they take the centre, in units."""
    apart = (T_true - T)[:3, :3] @ centre + (T_true - T)[:3, 3]
    return rotation_error_deg(T_true, T), float(np.linalg.norm(apart)) / unit


def _judged(clouds: PairClouds, T: np.ndarray) -> dict:
    if clouds.T_target_source is None:
        return {"rotation_error_deg": None, "translation_error": None, "overlap_truth": None}
    degrees, displacement = pose_difference(clouds.T_target_source, T, clouds.centre, clouds.unit)
    source, target = (
        np.asarray(cloud.voxel_down_sample(OVERLAP_GRID * clouds.unit).points)
        for cloud in (clouds.peers_source, clouds.peers_target)
    )
    overlap = overlap_ratio(source, target, clouds.T_target_source, OVERLAP_DISTANCE * clouds.unit)
    return {"rotation_error_deg": degrees, "translation_error": displacement, "overlap_truth": overlap}


@cache
def _warm_up(name: str) -> None:
    """Imports and compilation of a method happen before its first trial is timed: for small clouds and for large ones,
    which run in another loop."""
    for points in (500, 4000):
        problem = surface_pair(points)
        pair = plain_pair(problem.source.points, problem.target.points, None, unit=1.0)
        try:
            register_pair(name, pair)
        except Exception:
            return  # the trial itself will show and record it
