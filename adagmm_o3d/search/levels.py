"""Two mixtures and their coarser levels, each made when it is first needed, and EM from many starts on one of them."""

from __future__ import annotations

from functools import cached_property

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.colour import ColourEstimate
from adagmm_o3d.em.m_step import ANY_AXIS, turned_about
from adagmm_o3d.em.runs import End, Limits, Start, joined, run_starts
from adagmm_o3d.mixtures.merging import MergedMixture, count_certain, merge, sample
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.spacing import spacing_of_whole
from adagmm_o3d.search.schedule import Level, Schedule

Sides = tuple[MergedMixture, MergedMixture]


class Levels:
    """Two normalised mixtures, as every level of a schedule looks at them.

    axis : (3,) the only one to turn about, zero where any will do.
    small : whether the clouds are so small that all points decide; those flagged as outliers, which carry no weight, do
    not count.
    """

    def __init__(self, source: Mixture, target: Mixture, schedule: Schedule, axis: Array = ANY_AXIS) -> None:
        self.source, self.target, self.schedule, self.axis = source, target, schedule, axis
        self._made: dict[tuple[bool, int, int], Sides] = {}
        self._certain = count_certain(source), count_certain(target)
        self.small = max(self._certain) <= schedule.small

    def sides(self, level: Level) -> Sides:
        """Both mixtures on a level."""
        size = level.size[self.source.dimension - 2]
        return self.merged(size) if level.merged else self.sampled(size)

    def merged(self, size: int) -> Sides:
        """At most `size` components of either that stand for all points, without those flagged as outliers."""
        if max(self._certain) <= size:
            return self.sampled(size)
        key = (True, size, size)
        if key not in self._made:
            self._made[key] = merge(self.source, size), merge(self.target, size)
        return self._made[key]

    def sampled(self, size: int) -> Sides:
        """At most `size` of the points of either, without those flagged as outliers."""
        key = (False, min(size, self._certain[0]), min(size, self._certain[1]))
        if key not in self._made:
            self._made[key] = sample(self.source, size), sample(self.target, size)
        return self._made[key]

    def run(self, level: Level, starts: list[Start], number: int, *, sides: Sides | None = None) -> list[End]:
        """Where the starts lead on a level; `number` is what the record of the iterations calls it."""
        limits = Limits(level.floor, level.least_unmatched, level.relative_rmse, axis=self.axis)
        if self.axis.any():
            starts = [start._replace(pose=turned_about(self.axis, start.pose)) for start in starts]
        source, target = sides or self.sides(level)
        colour = None
        if starts and source.colours is not None and target.colours is not None:
            colour = ColourEstimate(source, target).prior()
        return run_starts(source, target, starts, limits=limits, level=number, colour=colour)

    def carry_on(self, level: Level, ends: list[End], number: int, *, sides: Sides | None = None) -> list[End]:
        """The ends gone on from on another level, each with the way that led to it in front."""
        starts = [
            Start(end.pose, level.sigma or end.sigma, end.unmatched, level.fastest, level.iterations, level.follow)
            for end in ends
        ]
        return joined(ends, self.run(level, starts, number, sides=sides))

    @cached_property
    def spacing(self) -> float:
        """Median distance from a point of the target to its nearest neighbour."""
        return spacing_of_whole(self.target)
