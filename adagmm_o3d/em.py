"""The EM loop of the paper's Figure 2 on two normalised mixtures."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .arguments import Array
from .expectation import Expectation
from .kernels.pair_loop import PairSums
from .lie import se_exp
from .m_step import solve_step
from .result import StopReason
from .sigma_rules import Scale


@dataclass(frozen=True)
class Criteria:
    """When an EM iteration has changed nothing worth another one; the words and numbers are Open3D's.

    The residual is flat at its minimum: a step of ε standard deviations changes it by about ε². So a pose has settled
    when a step is below √relative_rmse standard deviations of the mixtures.
    max_iteration bounds the EM iterations.
    """

    relative_rmse: float
    max_iteration: int


@dataclass
class Trace:
    """What happened: one entry for each iteration; `poses` has the start as well."""

    poses: list[Array]
    scales: list[Scale] = field(default_factory=list)
    energies: list[float] = field(default_factory=list)
    stop_reason: StopReason = StopReason.MAX_ITERATION
    sums: PairSums | None = None
    unobservable: tuple[Array, ...] = ()


def expectation_maximisation(
    expectation: Expectation,
    start: Array,
    criteria: Criteria,
    dimension: int,
    relaxation: float = 1.0,
    observe: Callable[[Trace], None] | None = None,
) -> Trace:
    """Move the source from `start` (4, 4) until pose and σ have settled or `max_iteration` is reached.

    `relaxation` lengthens every step. `observe` is called after each iteration.
    """
    pose = start
    trace = Trace([pose])
    for _ in range(criteria.max_iteration):
        # E-step: the weights of all pairs at the old pose, and their sums (Eq. 5).
        scale = expectation.scale
        sums = expectation.e_step(pose)
        if not sums.weight > 0.0:
            trace.stop_reason = StopReason.NO_OVERLAP
            break
        # M-step: R, t that lower Eq. 5, the weights held and the source's covariances turning with R.
        step = solve_step(sums.hessian, sums.gradient, dimension)
        pose = se_exp(relaxation * step.delta) @ pose
        trace.poses.append(pose)
        trace.scales.append(scale)
        trace.energies.append(sums.energy / sums.weight)
        trace.sums, trace.unobservable = sums, step.unobservable
        if observe is not None:
            observe(trace)
        # σ: both mixtures shrink as the clouds come together.
        settled = float(np.linalg.norm(step.delta)) <= math.sqrt(criteria.relative_rmse * scale.target)
        if expectation.shrink(pose, sums, settled):
            trace.stop_reason = StopReason.CONVERGED
            break
    return trace
