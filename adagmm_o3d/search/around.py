"""The first end, from the starts that deserve most trust, and where it leaves doubt a search among starts around them.

The posterior of a wrong pose can be as self-consistent as that of the right one, so EM alone cannot tell them apart.
The likelihood of both clouds can, and on merged mixtures it is cheap to ask for many starts.
"""

from __future__ import annotations

import math

from adagmm_o3d.em.runs import End, Start, distinct, pose_distance
from adagmm_o3d.sampling import quantile
from adagmm_o3d.search.levels import Levels, Sides


def first_end(levels: Levels, starts: list[Start]) -> tuple[End, End]:
    """The likeliest of the starts, on the merged level and carried on to the deciding one."""
    ends = levels.run(levels.schedule.merged, starts, 0)
    merged = max(ends, key=lambda end: end.log_likelihood)
    return merged, levels.carry_on(levels.schedule.deciding, [merged], 2, sides=deciding_sides(levels))[0]


def is_tight(levels: Levels, end: End) -> bool:
    """Whether the residuals of an end are so small beside the spacing of the points that it must be right."""
    if end.unmatched > levels.schedule.tight_unmatched:
        return False
    variance = sum(float(quantile(m.variances, 0.5)) for m in (levels.source, levels.target))
    return math.sqrt(end.sigma * variance) <= levels.schedule.tight * levels.spacing


def search_around(levels: Levels, starts: list[Start], first: tuple[End, End]) -> list[End]:
    """The first end and those of other starts, likeliest first, all on the deciding level."""
    merged, decided = first
    deciding, sides = levels.schedule.deciding, deciding_sides(levels)
    if levels.small:
        fewer = levels.sampled(levels.schedule.small_deciding)
        if fewer is not sides:
            sides, decided = fewer, levels.carry_on(deciding, [merged], 2, sides=fewer)[0]
    sketch = levels.schedule.sketch
    sketched = distinct(levels.run(sketch, starts, 0), sketch.kept, sketch.apart)
    rivals = [
        end for end in _narrowed(levels, sketched, merged) if pose_distance(end.pose, decided.pose) > deciding.apart
    ]
    ends = [decided, *levels.carry_on(deciding, rivals, 2, sides=sides)]
    return sorted(ends, key=lambda end: -end.log_likelihood)


def deciding_sides(levels: Levels) -> Sides:
    """What the deciding level looks at: all points of small clouds."""
    return levels.sampled(levels.schedule.small) if levels.small else levels.sides(levels.schedule.deciding)


def _narrowed(levels: Levels, sketched: list[End], merged: End) -> list[End]:
    """The few ends of a sketch that, after the merged and the ranking level, may be likelier than `merged`."""
    schedule = levels.schedule
    ends = levels.carry_on(schedule.merged, sketched, 0)
    kept = [end for end in distinct([merged, *ends], schedule.merged.kept, schedule.merged.apart) if end is not merged]
    if levels.sides(schedule.ranking) is levels.sides(schedule.merged):
        # On the same points there is nothing left to rank them by.
        return kept[: schedule.ranking.kept]
    return distinct(levels.carry_on(schedule.ranking, kept, 1), schedule.ranking.kept, schedule.ranking.apart)
