"""From a start to a pose: coarse to fine from the trusted starts; where that leaves doubt, a search; then all points.

The posterior of a wrong pose can be as self-consistent as that of the right one, so EM alone cannot tell them apart.
The likelihood of both clouds can, and on merged mixtures it is cheap to ask for many starts.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from adagmm_o3d.em.expectation import SIGMA_FLOOR
from adagmm_o3d.kernels.cpu.nearest_other import nearest_other_sq
from adagmm_o3d.mixtures.merging import MergedMixture, count_certain, merge, sample
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.sampling import quantile, some_of
from adagmm_o3d.search.runs import End, Limits, Start, distinct, joined, pose_distance, run_starts

# Components of the level on which a search tries its many starts and of the one on which few go on, points of the one
# that ranks those, and of the one that decides. Clouds of up to SMALL points decide with all of them; a search among
# small clouds does better on a part (heavy noise above all).
SKETCHED, MERGED, RANKING, DECIDING, SMALL, SMALL_DECIDING = {2: 24, 3: 64}, 200, 400, 1000, 1100, 500
# How far EM goes on each: what so many components can tell.
MERGED_LIMITS = Limits(floor=2e-3, least_unmatched=0.05, relative_rmse=5e-4)
RANKING_LIMITS = Limits(floor=1e-3, least_unmatched=0.05, relative_rmse=1e-3)
DECIDING_LIMITS = Limits(floor=SIGMA_FLOOR, least_unmatched=0.15, relative_rmse=4e-4)
# How many candidates go on from a level, and how far apart they have to be (see `pose_distance`).
KEPT_SKETCHED, KEPT_MERGED, APART_MERGED = 8, 4, 0.12
KEPT_RANKING, APART_RANKING = 2, 0.04
APART_DECIDING = 0.02
# Residuals within half the distance between neighbouring points are no coincidence where most points have a partner:
# no search is needed. Of a part of the points that much is found in many poses.
TIGHT, TIGHT_UNMATCHED = 0.5, 0.25
PROBES = 150
SPACING_FROM = 20_000


class Cascade:
    """Two normalised mixtures and their coarser levels, each made when it is first needed.

    volume : that over which points without a partner are spread, see `expectation.OPEN_VOLUME`.
    small : whether all points decide; those flagged as outliers, which carry no weight, do not count.
    """

    def __init__(self, source: Mixture, target: Mixture, volume: float) -> None:
        self.source, self.target, self.volume = source, target, volume
        self._samples: dict[tuple[int, int], tuple[MergedMixture, MergedMixture]] = {}
        self._certain = count_certain(source), count_certain(target)
        self.small = max(self._certain) <= SMALL

    @cached_property
    def _merged(self) -> tuple[MergedMixture, MergedMixture]:
        if max(self._certain) <= MERGED:
            return self.sampled(MERGED)
        return merge(self.source, MERGED), merge(self.target, MERGED)

    def sampled(self, size: int) -> tuple[MergedMixture, MergedMixture]:
        """At most `size` of the points of either, without those flagged as outliers."""
        sizes = min(size, self._certain[0]), min(size, self._certain[1])
        if sizes not in self._samples:
            self._samples[sizes] = sample(self.source, size), sample(self.target, size)
        return self._samples[sizes]

    def register_trusted(self, starts: list[Start]) -> tuple[End, End]:
        """The likeliest of the starts, on the merged level and carried on to the deciding one."""
        ends = self._run_merged(starts)
        merged = max(ends, key=lambda end: end.log_likelihood)
        return merged, self._decide([merged], SMALL if self.small else DECIDING)[0]

    def is_tight(self, end: End) -> bool:
        """Whether the residuals of an end are so small beside the spacing of the points that it must be right."""
        if end.unmatched > TIGHT_UNMATCHED:
            return False
        variance = sum(float(quantile(m.variances, 0.5)) for m in (self.source, self.target))
        return math.sqrt(end.sigma * variance) <= TIGHT * _spacing(self.target)

    def search(self, starts: list[Start], trusted: tuple[End, End]) -> list[End]:
        """The trusted end and those of other starts, likeliest first, all on the deciding level."""
        merged, decided = trusted
        size = DECIDING
        if self.small:
            size = SMALL_DECIDING
            if self.sampled(size) is not self.sampled(SMALL):
                decided = self._decide([merged], size)[0]
        sketched = run_starts(
            merge(self.source, SKETCHED[self.source.dimension]),
            merge(self.target, SKETCHED[self.source.dimension]),
            starts,
            limits=MERGED_LIMITS,
            volume=self.volume,
            level=0,
        )
        sketched = distinct(sketched, KEPT_SKETCHED, APART_MERGED)
        rivals = [
            end for end in self._narrowed(sketched, merged) if pose_distance(end.pose, decided.pose) > APART_DECIDING
        ]
        return sorted([decided, *self._decide(rivals, size)], key=lambda end: -end.log_likelihood)

    def run_deciding(self, starts: list[Start]) -> list[End]:
        """Run starts on the deciding level right away."""
        return self._run_sampled(starts, SMALL if self.small else DECIDING)

    def _narrowed(self, sketched: list[End], merged: End) -> list[End]:
        """The few ends of a sketch that, after the merged and the ranking level, may be likelier than `merged`."""
        again = [Start(end.pose, 2.0 * MERGED_LIMITS.floor, end.unmatched, 0.65, 4, follow=0.0) for end in sketched]
        ends = joined(sketched, self._run_merged(again))
        kept = [end for end in distinct([merged, *ends], KEPT_MERGED, APART_MERGED) if end is not merged]
        if self.sampled(RANKING) is self._merged:
            # On the same points there is nothing left to rank them by.
            return kept[:KEPT_RANKING]
        again = [Start(end.pose, 2.0 * MERGED_LIMITS.floor, end.unmatched, 0.65, 6, follow=0.0) for end in kept]
        ranked = run_starts(
            *self.sampled(RANKING),
            again,
            limits=RANKING_LIMITS,
            volume=self.volume,
            level=1,
        )
        return distinct(joined(kept, ranked), KEPT_RANKING, APART_RANKING)

    def _run_merged(self, starts: list[Start]) -> list[End]:
        return run_starts(*self._merged, starts, limits=MERGED_LIMITS, volume=self.volume, level=0)

    def _decide(self, ends: list[End], size: int) -> list[End]:
        again = [Start(end.pose, end.sigma, end.unmatched, fastest=0.75, iterations=20, follow=1.0) for end in ends]
        return joined(ends, self._run_sampled(again, size))

    def _run_sampled(self, starts: list[Start], size: int) -> list[End]:
        return run_starts(
            *self.sampled(size),
            starts,
            limits=DECIDING_LIMITS,
            volume=self.volume,
            level=2,
        )


def _spacing(mixture: Mixture) -> float:
    """Median distance from a point to its nearest neighbour, from a few probes.

    Of a large cloud only a part is looked at, and the spacing of the whole, a surface (in 2D a curve), follows from it.
    """
    points = mixture.points_at(some_of(np.arange(len(mixture)), SPACING_FROM))
    thinning = (len(points) / len(mixture)) ** (1.0 / (mixture.dimension - 1))
    probes = some_of(np.arange(len(points)), PROBES)
    squares = np.empty(len(probes))
    nearest_other_sq(np.ascontiguousarray(points.T), probes, squares)
    return math.sqrt(quantile(squares, 0.5)) * thinning
