"""The EM loop of the paper's Figure 2 on two normalised mixtures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .arguments import Array
from .kernels.pair_loop import PairLoop, PairSums
from .lie import se_exp
from .m_step import solve_step
from .result import StopReason
from .schedule import Scale, SigmaRule


@dataclass(frozen=True)
class Criteria:
    """When an EM iteration has changed nothing worth another one; the words and numbers are Open3D's.

    relative_fitness : change of the sum of the pair weights.   relative_rmse : change of the weighted RMS residual.
    max_iteration : EM iterations at most.
    """

    relative_fitness: float
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
    pairs: PairLoop,
    start: Array,
    rule: SigmaRule,
    criteria: Criteria,
    dimension: int,
    relaxation: float = 1.0,
    observe: Callable[[Trace], None] | None = None,
) -> Trace:
    """Move the source from `start` (4, 4) until the rule ends the loop or `max_iteration` is reached.

    `relaxation` lengthens every step. `observe` is called after each iteration.
    """
    pose = start
    trace = Trace([pose])
    scale = rule.first(pairs, pose)
    previous: PairSums | None = None
    for _ in range(criteria.max_iteration):
        # E-step: the weights C of all pairs at the old pose, and their sums (Eq. 5).
        sums = pairs.sums(pose, scale.source, scale.target)
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
        settled = previous is not None and _settled(previous, sums, scale, criteria)
        new_scale = rule.next(pairs, pose, sums, scale, settled)
        if new_scale is None:
            trace.stop_reason = StopReason.CONVERGED
            break
        scale, previous = new_scale, sums
    return trace


def _settled(previous: PairSums, now: PairSums, scale: Scale, criteria: Criteria) -> bool:
    rmse, old_rmse = (np.sqrt(s.energy / s.weight) for s in (now, previous))
    return bool(
        abs(now.weight - previous.weight) <= criteria.relative_fitness * previous.weight
        and abs(rmse - old_rmse) <= criteria.relative_rmse * old_rmse
    )
