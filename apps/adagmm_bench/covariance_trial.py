"""One trial of the pose covariance: the true error of a pose, squared, in units of what the covariance says of it."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.methods.ours import register
from adagmm_bench.problem import prepare
from adagmm_bench.trial import ProblemSource, TrialJob, judge, record_of
from adagmm_o3d import lie


def run_covariance_trial(job: TrialJob[ProblemSource]) -> dict:
    """Register by one of our variants, judge, and compare; the record has `nees`, see `normalised_error`."""
    problem = job.problem.load()
    prepared = prepare(problem, job.start)
    result = register(job.method, prepared.source, prepared.target)
    T = result.transformation
    return record_of(
        job,
        METHODS[job.method].version(),
        nees=normalised_error(prepared.prepared_pose(problem.T_target_source), T, result.pose_covariance),
        free=len(result.unobservable),
        **judge(problem, prepared.restore(T), job.problem.partner_distance),
    )


def normalised_error(truth: np.ndarray, T: np.ndarray, covariance: np.ndarray | None) -> float | None:
    """The normalised error squared δᵀ C⁻¹ δ with exp(δ)·T the truth; None where there is no covariance C.

    On average the number of directions of a pose if C is honest.
    """
    if covariance is None:
        return None
    error = lie.se_log(truth @ lie.se_inverse(T))
    return float(error @ np.linalg.solve(covariance, error))
