"""One trial: a problem, a method and a start in; what came of it out, as a record that goes into the journal."""

from __future__ import annotations

import math
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
import open3d as o3d

from adagmm_bench.methods import METHODS
from adagmm_bench.models import load_models, make_blob, make_outline, models_digest
from adagmm_bench.problem import Cloud, Problem, prepare
from adagmm_bench.simulation import TrialId, simulate
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import overlap_ratio, pose_errors

SIMULATION_PARTNER_DISTANCE = 0.1  # radii


class TrialSource(Protocol):
    """Where what is registered comes from, small enough to be sent to a worker, which loads or makes it there."""

    @property
    def key(self) -> str: ...

    def content(self) -> str:
        """A digest of the data that it is made of."""

    def facts(self) -> dict:
        """What a report groups by."""


class ProblemSource(TrialSource, Protocol):
    """Where a problem comes from."""

    @property
    def partner_distance(self) -> float:
        """Points nearer than this are partners, in the units of the clouds."""

    def load(self) -> Problem: ...


Source = TypeVar("Source", bound=TrialSource, covariant=True)


@dataclass(frozen=True)
class SimulatedProblem:
    """A trial of the paper's protocol, on the models of a file or on made shapes (None)."""

    trial_id: TrialId
    models_path: Path | None
    partner_distance: float = SIMULATION_PARTNER_DISTANCE

    @property
    def key(self) -> str:
        return f"{self.trial_id} on {self.models_path.name if self.models_path else 'made shapes'}"

    def load(self) -> Problem:
        return simulate(self.trial_id, load_models(self.trial_id.dimension, self.models_path).models)

    def content(self) -> str:
        return models_digest(self.models_path)

    def facts(self) -> dict:
        return self.trial_id.as_dict()


@dataclass(frozen=True)
class TrialJob(Generic[Source]):
    """A problem to be registered by one method from one start."""

    problem: Source
    method: str
    start: str

    @property
    def key(self) -> str:
        return f"{self.problem.key} | {self.method} | {self.start}"


def record_of(job: TrialJob[TrialSource], version: str, **outcome: Any) -> dict:
    """The record of a job: what it is of, by which version of its method, and what came of it."""
    return {
        "key": job.key,
        "method": job.method,
        "start": job.start,
        "version": version,
        "problem": job.problem.facts(),
        **outcome,
    }


def run_trial(job: TrialJob[ProblemSource]) -> dict:
    """Register and judge. A method that raises is a record too: it counts with the errors of its start.

    Everything in the record but its times is the same bits wherever it is run on the same kind of processor.
    """
    method = METHODS[job.method]
    if (reason := method.missing()) is not None:
        raise InputError(f"{job.method} {reason} on this worker")
    problem = job.problem.load()
    prepared = prepare(problem, job.start)
    _warm_up(job.method, problem.dimension)
    T_prepared, outcome = attempt(lambda: (method(prepared.source, prepared.target), {}))
    T = orthonormal(prepared.restore(np.eye(problem.dimension + 1) if T_prepared is None else T_prepared))
    return record_of(job, method.version(), **outcome, **judge(problem, T, job.problem.partner_distance))


def attempt(register: Callable[[], tuple[np.ndarray, dict]]) -> tuple[np.ndarray | None, dict]:
    """The pose that a method finds, None where it raises or finds no finite one, and what the record says of it: how it
    went, its times and what it says itself. `register` returns the pose and the last."""
    seed_generators()
    pose: np.ndarray | None = None
    said: dict = {}
    status, reason = "ok", ""
    started, started_cpu = time.perf_counter(), time.process_time()
    try:
        pose, said = register()
    except Exception as error:  # a peer may raise anything, and that is its result
        status, reason = "failed", " ".join(f"{type(error).__name__}: {error}".split())
    seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - started_cpu
    if pose is not None and not np.isfinite(pose).all():
        pose, status, reason = None, "failed", "the pose is not finite"
    return pose, {"status": status, "reason": reason, "seconds": seconds, "cpu_seconds": cpu_seconds, **said}


def judge(problem: Problem, T: np.ndarray, partner_distance: float) -> dict:
    """A pose between the clouds as they were given, its errors where the truth is known, and its overlap.

    Overlap is counted over the points that are not marked as outliers.
    """
    source, target = (cloud.points[~cloud.flagged()] for cloud in (problem.source, problem.target))
    record = {"T_target_source": T.tolist(), "overlap": overlap_ratio(source, target, T, partner_distance)}
    if problem.T_target_source is not None:
        errors = pose_errors(problem.T_target_source, T)
        record |= {
            "rotation_error": errors.rotation_frobenius,
            "rotation_error_deg": errors.rotation_deg,
            "translation_error": errors.translation,
            "overlap_truth": overlap_ratio(source, target, problem.T_target_source, partner_distance),
        }
    if bad := [name for name, value in record.items() if isinstance(value, float) and not math.isfinite(value)]:
        raise InputError(f"{problem.name}: {', '.join(bad)} of the record came out not finite")
    return record


def orthonormal(T: np.ndarray) -> np.ndarray:
    """The pose with the rotation nearest to its linear part: peers that work in float32 are 1e-7 off."""
    D = len(T) - 1
    U, _, Vt = np.linalg.svd(T[:D, :D])
    clean = np.array(T, dtype=float)
    clean[:D, :D] = U @ np.diag([1.0] * (D - 1) + [np.linalg.det(U @ Vt)]) @ Vt
    clean[D] = np.eye(D + 1)[D]
    return clean


def seed_generators() -> None:
    """The generators that peers draw from."""
    o3d.utility.random.seed(0)
    np.random.seed(0)
    random.seed(0)


@cache
def _warm_up(method_name: str, dimension: int) -> None:
    """Imports and compilation of a method happen before its first trial is timed."""
    points = (make_outline if dimension == 2 else make_blob)(0)
    cloud = Cloud(points, np.broadcast_to(np.eye(dimension), (len(points), dimension, dimension)))
    prepared = prepare(Problem("warm-up", cloud, cloud), "centroids")
    try:
        METHODS[method_name](prepared.source, prepared.target)
    except Exception:
        return  # the trial itself will show and record it
