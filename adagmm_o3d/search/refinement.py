"""The last level: the end of the search carried to convergence on all points.

Clouds of up to `Schedule.small` points run in one compiled loop. Dense clouds run condensed first, and on all of their
points only where σ has come down to what the condensed ones can tell apart, by way of ever larger parts of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from adagmm_o3d.em.expectation import (
    FASTEST,
    FINEST_SIGMA,
    LEAST_UNMATCHED,
    SAMPLED_SIGMA,
    PosteriorExpectation,
)
from adagmm_o3d.em.loop import Outcome, expectation_maximisation
from adagmm_o3d.em.runs import End, Limits, Start, joined, run_starts
from adagmm_o3d.kernels.update import MOVING, fresh_memory
from adagmm_o3d.mixtures.condensing import SIGMA_FLOOR, condense
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.sampling import some_of
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
# σ has come down to the floor of condensed clouds when it is within this factor of it. On all points it then begins at
# this share of the floor, where few pairs see each other and the pose is long good enough, and falls faster. There it
# is clear which points belong together, and one posterior of a pair does.
AT_FLOOR, BELOW_FLOOR, FASTEST_BELOW = 1.2, 0.1, 0.5
# There a part of the points takes σ down at first: while it is as wide as their spacing all points would meet very many
# others, and their pairs would grow with the square of their number. Each part has so many times the points of the one
# before, the first of them no fewer than SAMPLED_FROM; the spacing of a part holds σ up, so the next begins below it.
DENSER, SAMPLED_FROM, TOO_WIDE = 4, 20_000, 0.5

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
    end: End,
    criteria: Criteria,
    *,
    device: str,
    mutuality: float,
    relaxation: float,
    observe: Observe | None,
) -> Refined:
    """Carry an end of the search to convergence; its iterations stand before those that follow."""
    source, target = levels.source, levels.target
    if levels.small and mutuality == 0.0:
        outcome, fit = _refine_compiled(levels, end, criteria, relaxation, observe)
        return Refined(outcome, fit, make_pair_loop(source, target, device), source, target)

    def run(
        sides: tuple[Mixture, Mixture], fit: Fit, most: int, floor: float, fastest: float, mutuality: float
    ) -> Refined:
        pairs = make_pair_loop(*sides, device)
        expectation = PosteriorExpectation(
            pairs,
            source.dimension,
            fit.sigma,
            unmatched=fit.unmatched,
            mutuality=mutuality,
            fastest=fastest,
            floor=floor,
            accelerated=ACCELERATED,
        )
        outcome = expectation_maximisation(
            expectation,
            fit.pose,
            replace(criteria, max_iteration=most),
            source.dimension,
            relaxation=relaxation,
            level=LEVEL,
            observe=observe,
        )
        ended = Fit(outcome.pose, expectation.scale.target, expectation.unmatched, mutuality)
        return Refined(outcome, ended, pairs, *sides)

    found = Fit(end.pose, end.sigma, end.unmatched, mutuality)
    condensed = condense(source), condense(target)
    dense = condensed[0] is not source or condensed[1] is not target
    refined = run(condensed, found, criteria.max_iteration, SIGMA_FLOOR if dense else SAMPLED_SIGMA, FASTEST, mutuality)
    iterations = refined.outcome.iterations
    below = BELOW_FLOOR * SIGMA_FLOOR
    sharp = refined.outcome.stop_reason is StopReason.CONVERGED and refined.fit.sigma <= AT_FLOOR * SIGMA_FLOOR
    for sides in _parts(source, target) if dense and sharp else []:
        left = criteria.max_iteration - len(iterations)
        if left <= 0:
            break
        refined = run(sides, replace(refined.fit, sigma=below), left, FINEST_SIGMA, FASTEST_BELOW, 0.0)
        below = TOO_WIDE * refined.fit.sigma
        iterations += refined.outcome.iterations
    return replace(refined, outcome=replace(refined.outcome, iterations=end.iterations + iterations))


def _parts(source: Mixture, target: Mixture) -> list[tuple[Mixture, Mixture]]:
    """At most so many points of either cloud, DENSER times as many each time, in the end all."""
    count = max(len(source), len(target))
    sides = [(source, target)]
    while (count := count // DENSER) >= SAMPLED_FROM:
        sides.append((_part(source, count), _part(target, count)))
    return sides[::-1]


def _part(mixture: Mixture, count: int) -> Mixture:
    return mixture.take(some_of(np.arange(len(mixture)), count))


def _refine_compiled(
    levels: Levels, end: End, criteria: Criteria, relaxation: float, observe: Observe | None
) -> tuple[Outcome, Fit]:
    """Without a return to Python, which would cost small clouds more than their pairs do; where somebody observes, with
    one after each iteration, and to the same bits."""
    sides = levels.sampled(levels.schedule.small)
    limits = Limits(
        SAMPLED_SIGMA,
        LEAST_UNMATCHED,
        criteria.relative_rmse,
        accelerated=ACCELERATED,
        bits=CUT_BITS,
        relaxation=relaxation,
    )
    refined, left, memories = end, criteria.max_iteration, fresh_memory(1)
    while left > 0:
        most = left if observe is None else 1
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
