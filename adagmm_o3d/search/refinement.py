"""The last level: the end of the search carried to convergence, in steps of the scale.

Clouds of up to `Schedule.small` points run in one compiled loop. Dense clouds run on their cells, all others on their
points; while σ is so wide that a point would meet very many others, on coarser ones, see `mixtures.condensing`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from adagmm_o3d.em.colour import estimate_between
from adagmm_o3d.em.expectation import (
    FASTEST,
    FINEST_SIGMA,
    LEAST_UNMATCHED,
    SAMPLED_SIGMA,
    PosteriorExpectation,
    posterior_rule,
)
from adagmm_o3d.em.loop import Outcome, expectation_maximisation
from adagmm_o3d.em.runs import End, Limits, Start, joined, run_starts
from adagmm_o3d.kernels.update import MOVING, fresh_memory
from adagmm_o3d.mixtures.condensing import SIGMA_FLOOR, Condensed
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.options import Criteria
from adagmm_o3d.pairs.cpu_pairs import CUT_BITS
from adagmm_o3d.pairs.device import make_pair_loop
from adagmm_o3d.pairs.protocol import Pairs
from adagmm_o3d.result import Iteration, StopReason
from adagmm_o3d.search.levels import Levels
from adagmm_o3d.trust.pose_covariance import Fit

LEVEL = 3
# Whether steps are extrapolated, see `kernels.cpu.acceleration`: here, where no ends are compared any more.
ACCELERATED = True
# σ may fall to the share STEP of itself before the components are made anew. They are made anew if it has come within
# the factor AT_FLOOR of that.
STEP, AT_FLOOR = 0.25, 1.2
# Below SIGMA_FLOOR it is clear which parts of dense clouds belong together: σ may fall faster, and the posterior that a
# pair has from the source's side is enough.
FASTEST_BELOW = 0.5
# The compiled loop keeps room for the record of so many iterations at a time, however many are allowed.
PORTION = 1000

Observe = Callable[[Iteration], None]


@dataclass(frozen=True)
class Refined:
    """Where EM ended, the mixtures' parameters there, and the mixtures it ended on with the pairs of the two."""

    outcome: Outcome
    fit: Fit
    pairs: Pairs
    source: Mixture
    target: Mixture


def refine(
    levels: Levels,
    clouds: tuple[Condensed, Condensed],
    end: End,
    criteria: Criteria,
    *,
    device: str,
    mutuality: float,
    relaxation: float,
    observe: Observe | None,
) -> Refined:
    """Carry an end of the search among `levels` of the `clouds` to convergence; its iterations stand before those that
    follow."""
    sides = levels.source, levels.target
    coloured = all(side.colours is not None for side in sides)
    if levels.small and mutuality == 0.0 and not coloured:
        outcome, fit = _refine_compiled(levels, end, criteria, relaxation, observe)
        return Refined(outcome, fit, make_pair_loop(*sides, device), *sides)

    def run(
        sides: tuple[Mixture, Mixture], fit: Fit, most: int, floor: float, fastest: float, mutuality: float
    ) -> Refined:
        """EM from a fit on two mixtures until pose and σ have settled, σ at `floor` if it would fall further."""
        pairs = make_pair_loop(*sides, device)
        expectation = PosteriorExpectation(
            pairs,
            posterior_rule(levels.source.dimension, fastest=fastest, floor=floor, accelerated=ACCELERATED),
            fit.sigma,
            unmatched=fit.unmatched,
            mutuality=mutuality,
            colours=estimate_between(*sides),
        )
        outcome = expectation_maximisation(
            expectation,
            fit.pose,
            replace(criteria, max_iteration=most),
            levels.source.dimension,
            relaxation=relaxation,
            axis=levels.axis,
            level=LEVEL,
            observe=observe,
        )
        ended = Fit(outcome.pose, expectation.scale.target, expectation.unmatched, mutuality, expectation.colour)
        return Refined(outcome, ended, pairs, *sides)

    dense = any(cloud.dense for cloud in clouds)
    last = max(FINEST_SIGMA, *(cloud.last for cloud in clouds)) if dense else SAMPLED_SIGMA
    fit = Fit(end.pose, end.sigma, end.unmatched, mutuality)
    iterations: tuple[Iteration, ...] = ()
    while True:
        below = dense and fit.sigma <= AT_FLOOR * SIGMA_FLOOR
        floor = last
        if dense or any(cloud.meets_many(fit.sigma) for cloud in clouds):
            floor = max(STEP * fit.sigma, last)
        refined = run(
            (clouds[0].at(fit.sigma, floor), clouds[1].at(fit.sigma, floor)),
            fit,
            criteria.max_iteration - len(iterations),
            floor,
            FASTEST_BELOW if below else FASTEST,
            0.0 if below else mutuality,
        )
        iterations += refined.outcome.iterations
        fit = refined.fit
        done = floor <= last or fit.sigma > AT_FLOOR * floor or len(iterations) >= criteria.max_iteration
        if done or refined.outcome.stop_reason is not StopReason.CONVERGED:
            return replace(refined, outcome=replace(refined.outcome, iterations=end.iterations + iterations))


def _refine_compiled(
    levels: Levels, end: End, criteria: Criteria, relaxation: float, observe: Observe | None
) -> tuple[Outcome, Fit]:
    """The same in one compiled loop: for small clouds a return to Python costs more than the pairs do. It returns after
    each PORTION, for an observer after each iteration, which changes no bit."""
    sides = levels.sampled(levels.schedule.small)
    limits = Limits(
        SAMPLED_SIGMA,
        LEAST_UNMATCHED,
        criteria.relative_rmse,
        accelerated=ACCELERATED,
        bits=CUT_BITS,
        relaxation=relaxation,
        axis=levels.axis,
    )
    refined, left, memories = end, criteria.max_iteration, fresh_memory(1)
    while left > 0:
        most = min(left, PORTION) if observe is None else 1
        start = Start(refined.pose, refined.sigma, refined.unmatched, FASTEST, most, follow=1.0)
        ends = run_starts(*sides, [start], limits=limits, level=LEVEL, memories=memories)
        if observe is not None:
            for iteration in ends[0].iterations:
                observe(iteration)
        left -= most
        refined = joined([refined], ends)[0]
        if refined.state != MOVING:
            break
    fit = Fit(refined.pose, refined.sigma, refined.unmatched, mutuality=0.0)
    return Outcome(refined.pose, refined.iterations, refined.stop_reason), fit
