"""One trial of the pose covariance: the true error of a pose, squared, in units of what the covariance says of it."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.methods.ours import register
from adagmm_bench.problem import prepare
from adagmm_bench.trial import ProblemSource, TrialJob, judge, record_of
from adagmm_o3d import lie


def run_covariance_trial(job: TrialJob[ProblemSource]) -> dict:
    """Register by one of our variants, judge, and compare.

    The record has `nees`, the normalised error squared δᵀ C⁻¹ δ with exp(δ)·T the truth: on average the number of
    directions of a pose if the covariance C is honest. None where there is no covariance.
    """
    problem = job.problem.load()
    prepared = prepare(problem, job.start)
    result = register(job.method, prepared.source, prepared.target)
    T, covariance, nees = result.transformation, result.pose_covariance, None
    if covariance is not None:
        error = lie.se_log(prepared.prepared_pose(problem.T_target_source) @ lie.se_inverse(T))
        nees = float(error @ np.linalg.solve(covariance, error))
    return record_of(
        job,
        METHODS[job.method].version(),
        nees=nees,
        free=len(result.unobservable),
        **judge(problem, prepared.restore(T), job.problem.partner_distance),
    )
