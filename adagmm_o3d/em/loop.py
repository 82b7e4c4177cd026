"""The EM loop of the paper's Figure 2 on two normalised mixtures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.expectation import Expectation
from adagmm_o3d.em.m_step import ANY_AXIS, solve_step
from adagmm_o3d.options import Criteria
from adagmm_o3d.result import Iteration, StopReason, stop_reason


@dataclass(frozen=True)
class Outcome:
    """Where the loop ended and how."""

    pose: Array
    iterations: tuple[Iteration, ...]
    stop_reason: StopReason


def expectation_maximisation(
    expectation: Expectation,
    start: Array,
    criteria: Criteria,
    dimension: int,
    *,
    relaxation: float = 1.0,
    axis: Array = ANY_AXIS,
    level: int = 0,
    observe: Callable[[Iteration], None] | None = None,
) -> Outcome:
    """Move the source from `start` (4, 4) until pose and σ have settled or `max_iteration` is reached.

    `relaxation` lengthens every step; `axis` (3,) is the only one to turn about, zero where any will do; `observe` is
    called after each iteration.
    """
    pose = start
    iterations: list[Iteration] = []
    done, determined = False, True
    for _ in range(criteria.max_iteration):
        # E-step: the weights of all pairs at the old pose, and their sums (Eq. 5).
        sigma = expectation.scale.source
        sums = expectation.e_step(pose)
        if not sums.weight > 0.0:
            return Outcome(pose, tuple(iterations), StopReason.NO_OVERLAP)
        # M-step: R, t that lower Eq. 5, the weights held.
        delta, determined, short = solve_step(
            sums.total, dimension, relaxation=relaxation, relative_rmse=criteria.relative_rmse, sigma=sigma, axis=axis
        )
        # σ: both mixtures shrink as the clouds come together.
        pose, done = expectation.advance(pose, delta, sums, short)
        iterations.append(Iteration(pose, sigma, sums.energy / sums.weight, expectation.matched(sums), level))
        if observe is not None:
            observe(iterations[-1])
        if done:
            break
    return Outcome(pose, tuple(iterations), stop_reason(done, determined))
