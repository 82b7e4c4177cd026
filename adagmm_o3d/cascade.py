"""From many starts on coarse mixtures to one pose on all points: search, decide, refine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .arguments import Array
from .coarse import merge, sample
from .em import Criteria, Outcome, expectation_maximisation
from .expectation import PosteriorExpectation, uniform_density
from .kernels.pair_loop import PairLoop
from .mixture import Mixture
from .start_search import JUDGED_UNMATCHED, End, Start, distinct, run_starts
from .trace import Iteration

# Components on the two coarse levels, and points on the one that decides between the last candidates.
MERGED, SAMPLED, DECIDING = 200, 400, 1500
# Standard deviations (squared) to which σ may fall on the coarse levels: what so few components can tell.
MERGED_FLOOR, SAMPLED_FLOOR = 2e-3, 1e-3
# How many candidates go on from each level, and how far apart they are (‖ΔR‖_F + ‖Δt‖, normalised).
KEPT_MERGED, APART_MERGED = 4, 0.12
KEPT_SAMPLED, APART_SAMPLED = 2, 0.04


@dataclass(frozen=True)
class Candidate:
    """A pose that has been refined, and how well it explains both clouds."""

    start: Array
    outcome: Outcome
    sigma: float
    unmatched: float
    log_likelihood: float


def search(source: Mixture, target: Mixture, starts: list[Start]) -> list[End]:
    """The likeliest ends of all starts, at most KEPT_SAMPLED, best first. The first start is always among those that
    reach the second level, and there σ follows its residuals: under heavy noise it is the one that must not be forced.
    """
    merged = run_starts(merge(source, MERGED), merge(target, MERGED), starts, floor=MERGED_FLOOR, level=0)
    kept = distinct(merged, KEPT_MERGED, APART_MERGED)
    first = merged[0]
    again = [_continued(first, first.sigma, follow=1.0)]
    again += [_continued(end, 2.0 * MERGED_FLOOR, follow=0.0) for end in kept if end is not first]
    before = [first, *(end for end in kept if end is not first)]
    sampled = run_starts(sample(source, SAMPLED), sample(target, SAMPLED), again, floor=SAMPLED_FLOOR, level=1)
    joined = [
        replace(end, start=old.start, iterations=old.iterations + end.iterations)
        for old, end in zip(before, sampled, strict=True)
    ]
    return distinct(joined, KEPT_SAMPLED, APART_SAMPLED)


def _continued(end: End, sigma: float, *, follow: float) -> Start:
    return Start(end.pose, sigma, end.unmatched, two_sided=False, fastest=0.75, iterations=8, follow=follow)


def decide(
    source: Mixture, target: Mixture, ends: list[End], criteria: Criteria, *, two_sided: bool
) -> list[Candidate]:
    """Each end refined on at most DECIDING points of either cloud; likeliest first."""
    pairs = PairLoop(_at_most(source, DECIDING), _at_most(target, DECIDING))
    dimension = source.dimension
    candidates = []
    for end in ends:
        expectation = PosteriorExpectation(pairs, dimension, end.sigma, unmatched=end.unmatched, two_sided=two_sided)
        outcome = expectation_maximisation(expectation, end.pose, criteria, dimension, level=2)
        sigma = expectation.scale.target
        judged, _ = pairs.posterior_sums(outcome.pose, sigma, uniform_density(JUDGED_UNMATCHED, dimension))
        outcome = replace(outcome, iterations=end.iterations + outcome.iterations)
        candidates.append(Candidate(end.start, outcome, sigma, expectation.unmatched, judged.log_likelihood))
    return sorted(candidates, key=lambda candidate: -candidate.log_likelihood)


def refine(
    pairs: PairLoop,
    candidate: Candidate,
    criteria: Criteria,
    dimension: int,
    *,
    two_sided: bool,
    relaxation: float,
    observe: Callable[[Iteration], None] | None,
) -> Outcome:
    """The candidate refined on all points."""
    expectation = PosteriorExpectation(
        pairs, dimension, candidate.sigma, unmatched=candidate.unmatched, two_sided=two_sided
    )
    outcome = expectation_maximisation(
        expectation, candidate.outcome.pose, criteria, dimension, relaxation=relaxation, level=3, observe=observe
    )
    return replace(outcome, iterations=candidate.outcome.iterations + outcome.iterations)


def _at_most(mixture: Mixture, count: int) -> Mixture:
    if len(mixture) <= count:
        return mixture
    return mixture.take(np.sort(np.random.default_rng(0).permutation(len(mixture))[:count]))
