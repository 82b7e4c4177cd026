"""Where to start and which end to believe: trusted starts first, then whatever is needed to be sure.

Starts come from where the caller says, from common centroids, from a ring around them, from local features, from a grid
of rotations, from turning a sensor in place and from the directions that surfaces face; their ends are candidates of
one pool, and one judge compares them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import End, Start, distinct, pose_distance
from adagmm_o3d.sampling import first_of_alike
from adagmm_o3d.search import starts
from adagmm_o3d.search.around import first_end, is_tight, search_around
from adagmm_o3d.search.directions import direction_poses
from adagmm_o3d.search.features import feature_poses, thinned_alike
from adagmm_o3d.search.levels import Levels
from adagmm_o3d.search.rotations import APART_AMBIGUOUS, search_globally
from adagmm_o3d.search.schedule import SAME_START
from adagmm_o3d.trust.agreement import HELD, log_held
from adagmm_o3d.trust.judge import ALIKE_HELD, CERTAIN, KNOWN_AGAIN, Judge, holds, of_rival
from adagmm_o3d.trust.rivals import SIGMA, refined

# Evidence above which a pose stands by itself [nats per point, both clouds together], see `judge.Judge.evidence`, and
# how much has to hold there, or more is tried: clean clouds explain so much of each other in wrong poses too.
ESTABLISHED, ESTABLISHED_HELD = 0.4, 0.85
# By how much another pose has to explain the clouds better than the one near the start that the caller gave: a little
# where it stands by itself, or where by the one near the start the clouds rather lie apart; more where neither does.
BETTER, MUCH_BETTER = 0.05, 0.25
# Two clearly different poses whose evidence, or whose likelihood where noise hides the shape, differs by less [nats per
# point, both clouds together] cannot be told apart. Measured gaps of likelihood: symmetric bodies sampled twice 0.00 to
# 0.17 (1 of 30 above), rooms 0.07 and more (4 of 60 below), the simulation's models 1.9 and more.
AMBIGUOUS, AMBIGUOUS_LIKELIHOOD = 0.1, 0.15
# A given start is believed at once when the clouds explain each other there KNOWN_AGAIN times as well as the halves of
# one cloud do; or, where noise hides the shape, when this share of the points has a partner. The identity that nobody
# vouched for is kept then if it holds, and any pose like that is a rival.
PLAUSIBLE = 0.1
# Below so much of that, or where no pose is established if it is not known from where the clouds were seen, surfaces
# that face alike are laid on each other as well. Walls and floors do that in many wrong ways, which free space tells
# from the right one; without viewpoints such a pose must hold so far to be taken.
SETTLED, HOLDS = 0.5, HELD[1]
# Clouds that hold where they were left are hardly there by chance: an end no further from its start [radii, radians]
# is a rival, whatever explains more; and where somebody vouched for the start it is taken if so much holds, or even
# with so little evidence if as much as between the halves of a cloud does: where a third is shared it may be that the
# clouds rather lie apart. In the plane, where nothing is known of what holds, only without a search. Where another pose
# is right none does (377 pairs).
STAYED, STAYS, LITTLE_SHARED = 0.2, 0.65, -0.5
# Evidence above which an end near the start counts where it holds: of clouds that share a half it may be about none. If
# nobody vouched for the start, and elsewhere more holds and more is explained, no further from it than this.
COUNTS, NEARBY = -0.1, 0.5
# Where the first few proposals of features establish no pose, so many times as many are tried.
MORE = 4
# What is assumed of points without a partner where σ begins anew.
FRESH_UNMATCHED = 0.5


@dataclass(frozen=True)
class Found:
    """The end to refine, and whether another, clearly different one explains the clouds as well; or whether it is
    certain: the same points were sampled."""

    end: End
    ambiguous: bool
    certain: bool = False


@dataclass(frozen=True, eq=False)
class Candidate:
    """An end of the search, and its evidence; see `Judge.evidence`.

    least_held : what has to hold for it to be taken; it is a rival of others whether or not.
    """

    judge: Judge
    end: End
    evidence: float
    least_held: float = 0.0

    @cached_property
    def value(self) -> float:
        """The evidence, less a nat for each factor e by which less holds than of a cloud's own halves.

        Walls and floors that are piled up loosely in a wrong way explain much of both clouds, as the right pose of
        clouds that share a third does; but where one cloud goes on the other is beside it.
        """
        held = self.held
        return self.evidence + log_held(held) - log_held(1.0) if held >= self.least_held else -math.inf

    @cached_property
    def held(self) -> float:
        """See `Judge.held`."""
        return self.judge.held(self.end.pose)


def find(
    levels: Levels,
    *,
    given: Array | None,
    identity: Array | None,
    centroids: bool,
    everywhere: bool,
    search: bool,
    judge: Callable[[], Judge],
    viewpoints: tuple[Array | None, Array | None],
) -> Found:
    """The end to refine on all points.

    Parameters
    ----------
    given : (4, 4) pose that somebody has vouched for, or None.
    identity : (4, 4) the input's identity, or None if it means nothing.
    centroids : whether common centroids are a start.   everywhere : whether nothing is known of the pose.
    search : whether to search where the first end, and those near the pose that is believed, leave doubt.
    judge : made when it is first needed.   viewpoints : see `judge.Judge`.
        All of it between the normalised mixtures.
    """
    believed = given if given is not None else identity
    bases = [base for base in (np.eye(4) if centroids and given is None else None, believed) if base is not None]
    if everywhere or not bases:
        bases = [np.eye(4)]
    if pose_distance(bases[0], bases[-1]) < SAME_START:
        bases = bases[:1]
    first = None
    if not everywhere:
        first = first_end(levels, [starts.wide(base) for base in bases])
        if is_tight(levels, first[1]):
            return Found(first[1], False, certain=True)
    sharp = levels.source.dimension == 3 and judge().sharp
    pool = _judged(judge(), [first[1]]) if sharp and first is not None else []
    # Nothing that features propose does better than a certain end.
    certain = bool(pool) and pool[0].evidence >= CERTAIN * judge().reference
    nearby: list[End] = []
    # Where the first end is certain, an identity that nobody vouched for needs no look if the clouds lie apart there.
    apart = certain and given is None and believed is not None and judge().confidence(believed) <= 0.0
    if believed is not None and not everywhere and (sharp or given is not None or not search) and not apart:
        nearby = levels.run(levels.schedule.near, starts.near(believed), 2)
    if first is not None and not search:
        if sharp:
            # Who wants no search vouches for where it begins.
            return _found(judge(), _judged(judge(), nearby), pool, vouched=True)
        stayed = [end for end in nearby if _moved(end) < STAYED and end.unmatched <= 1.0 - PLAUSIBLE]
        return Found(_most_likely(stayed or [first[1], *nearby]), False)
    if not sharp:
        # Noise hides the shape at the scale of the points: the likelihood at the noise's own scale decides.
        if first is None:
            ends = search_globally(levels)
        elif given is not None and _most_likely([first[1], *nearby]).unmatched <= 1.0 - PLAUSIBLE:
            return Found(_most_likely([first[1], *nearby]), False)
        else:
            ends = search_around(levels, _others(levels, bases), first)
        return Found(ends[0], is_ambiguous([(end, end.log_likelihood) for end in ends], AMBIGUOUS_LIKELIHOOD))
    near, vouched = _judged(judge(), nearby), given is not None
    if vouched and near and max(one.evidence for one in near) >= KNOWN_AGAIN * judge().reference:
        return _found(judge(), near, [], vouched)
    if certain:
        return _found(judge(), near, pool, vouched)
    most, apart_by = levels.schedule.proposed.kept, levels.schedule.proposed.apart
    alike = thinned_alike(levels.source, levels.target)
    proposals = _apart(feature_poses(alike), apart_by)
    pool += _judged(judge(), _proposed(levels, proposals[:most]))
    seen_from = viewpoints[0] is not None and viewpoints[1] is not None
    if not _reaches([*near, *pool], SETTLED * judge().reference if seen_from else ESTABLISHED):
        laid = _apart(direction_poses(alike), apart_by)
        pool += _judged(judge(), _proposed(levels, laid[:most]), 0.0 if seen_from else HOLDS)
    if not _reaches([*near, *pool], ESTABLISHED, ESTABLISHED_HELD):
        more = _proposed(levels, proposals[most : MORE * most])
        more += search_globally(levels) if first is None else search_around(levels, _others(levels, bases), first)
        if viewpoints[0] is not None and viewpoints[1] is not None:
            more += _starts_in_place(levels, viewpoints[0], viewpoints[1])
        pool += _judged(judge(), more)
    return _found(judge(), near, pool, vouched)


def _most_likely(ends: list[End]) -> End:
    return max(ends, key=lambda end: end.log_likelihood)


def _others(levels: Levels, bases: list[Array]) -> list[Start]:
    """Starts around the bases of the first end."""
    return [*starts.around(bases[0], levels.source.dimension), *(starts.narrow(base) for base in bases[1:])]


def _apart(poses: list[Array], distance: float) -> list[Array]:
    """Those of the poses that are clearly different from all before them."""
    if not poses:
        return []
    everything = np.array(poses)
    return [poses[k] for k in first_of_alike(pose_distance(everything[:, None], everything) <= distance)]


def _proposed(levels: Levels, poses: list[Array]) -> list[End]:
    """Where proposed poses lead."""
    level = levels.schedule.proposed
    begin = [Start(pose, level.sigma or 0.0, 0.4, level.fastest, level.iterations, level.follow) for pose in poses]
    return _decided(levels, levels.run(level, begin, 2))


def _decided(levels: Levels, ends: list[End]) -> list[End]:
    """Where the ends of proposed poses lead; most of these become one."""
    level = levels.schedule.proposed_deciding
    return levels.carry_on(level, distinct(ends, len(ends), level.apart), 2)


def _starts_in_place(levels: Levels, source_viewpoint: Array, target_viewpoint: Array) -> list[End]:
    """Where a sensor leads that was turned, not moved, between the two clouds."""
    level = levels.schedule.in_place
    poses = starts.turned_in_place(source_viewpoint, target_viewpoint)
    begin = [Start(pose, level.sigma or 0.0, 0.4, level.fastest, level.iterations, level.follow) for pose in poses]
    ends = distinct(levels.run(level, begin, 0), level.kept, level.apart)
    return _decided(levels, levels.carry_on(levels.schedule.proposed, ends, 2))


def _judged(judge: Judge, ends: list[End], least_held: float = 0.0) -> list[Candidate]:
    evidence = judge.evidence([end.pose for end in ends]).tolist() if ends else []
    return [Candidate(judge, end, value, least_held) for end, value in zip(ends, evidence, strict=True)]


def _ranked(candidates: list[Candidate]) -> list[Candidate]:
    """Those that may be chosen or rival what is, the best first."""
    if len(candidates) == 1:
        return candidates  # whether it holds changes nothing
    ranked: list[Candidate] = []
    best = -math.inf
    for one in sorted(candidates, key=lambda one: -one.evidence):
        # a value is no more than the evidence: whether this one holds, and all after it, need not be known
        if one.evidence < best - MUCH_BETTER - AMBIGUOUS:
            break
        ranked.append(one)
        best = max(best, one.value)
    return sorted(ranked, key=lambda one: -one.value)


def _reaches(candidates: list[Candidate], value: float, held: float = 0.0) -> bool:
    """Whether one of them is worth so much, and so much holds; a value is no more than the evidence, which is known
    already."""
    likely = sorted((one for one in candidates if one.evidence >= value), key=lambda one: -one.evidence)
    return any(one.value >= value and one.held >= held for one in likely)


def _found(judge: Judge, near: list[Candidate], pool: list[Candidate], vouched: bool) -> Found:
    known = judge.known(max(one.evidence for one in (*near, *pool)))
    chosen, rivals = _chosen(near, pool, known, vouched=vouched)
    # To stay in the nearest optimum σ was forced down, maybe below the noise, where chance decides who is a partner of
    # whom.
    sigma, unmatched = max(chosen.sigma, judge.sigma), min(chosen.unmatched, FRESH_UNMATCHED)
    end = chosen._replace(sigma=sigma, unmatched=unmatched)
    return Found(end, _stay_apart(judge, end.pose, rivals))


def _chosen(near: list[Candidate], pool: list[Candidate], known: float, *, vouched: bool) -> tuple[End, list[Array]]:
    """The best of all, or the nearest to the given start of those near it that hold no less, or as the halves of a
    cloud do, or to which none is clearly better; and its rivals. Evidence above `known` may be a right pose's, close to
    the start, or near one that was `vouched` for, all above COUNTS where that is finite."""
    ranked = _ranked([*near, *pool])
    best = ranked[0]
    at_start = next((one for one in ranked if one in near), None)
    # Where clouds share little or shapes repeat themselves, walls come together and shelves fall on shelves in wrong
    # ways that explain more than the right one; but they hold less. Not beside what is certain, or what colours say.
    more = best.held + ALIKE_HELD if best in near else best.held
    plausible = [one for one in near if known < math.inf and one.evidence > COUNTS]
    right = [one for one in plausible if one.held >= more]
    stayed = _stayed(near, vouched=vouched) if known < math.inf else []
    if best in near:
        right.append(best)
    else:
        # As much as the halves of a cloud hold is no less.
        as_halves = [one for one in plausible if holds(one.held) and one not in right]
        right += [one for one in as_halves if vouched or one.evidence > known or _moved(one.end) < NEARBY]
        if vouched:
            right += [one for one in stayed if one not in right]
        # What explains clearly more and is close by is where such a one was on the way to.
        right = [one for one in right if best.value < one.value + MUCH_BETTER or _apart_from(best, one.end.pose)]
    if right:
        best = _nearest(right)
    elif at_start is not None:
        wanted = BETTER if best.value >= ESTABLISHED or at_start.value <= 0.0 < best.value else MUCH_BETTER
        if best.value < at_start.value + wanted:
            best = at_start
    if best in near and len(near) > 1:
        # Where walls slide on each other, many poses near the start explain the same. A value is no more than the
        # evidence.
        least = best.value - BETTER
        best = _nearest([one for one in near if one.evidence >= least and one.value >= least])
    # What is beside a surface may have come there since: a pose that holds less but explains as much is a rival.
    others = [(one.end, one.evidence) for one in ranked if one is not best]
    rivals = _rivals([(best.end, best.evidence), *others], AMBIGUOUS)
    least = of_rival(known, best.evidence)
    explaining = [one for one in (*near, *pool) if one.evidence > least and _apart_from(best, one.end.pose)]
    rivals += [one.end.pose for one in explaining if holds(one.held, best.held)]
    # What slid a little from where the best is too is no other place.
    return best.end, rivals + [one.end.pose for one in stayed if _apart_from(best, one.end.start)]


def _apart_from(one: Candidate, pose: Array) -> bool:
    """Whether a pose is clearly another one."""
    return bool(pose_distance(one.end.pose, pose) > APART_AMBIGUOUS)


def _stayed(near: list[Candidate], *, vouched: bool) -> list[Candidate]:
    """Those that hold about where they were left."""
    least = LITTLE_SHARED if vouched else 0.0
    there = [one for one in near if one.evidence > least and _moved(one.end) < STAYED]
    return [one for one in there if holds(one.held) or (vouched and one.evidence > 0.0 and one.held >= STAYS)]


def _nearest(candidates: list[Candidate]) -> Candidate:
    """To their start."""
    return min(candidates, key=lambda one: _moved(one.end))


def _moved(end: End) -> float:
    """From its start."""
    return float(pose_distance(end.start, end.pose))


def _stay_apart(judge: Judge, pose: Array, rivals: list[Array]) -> bool:
    """Whether a rival of a pose leads elsewhere, refined as it is: ends of a search may be on the way to one place."""
    if not rivals:
        return False
    own, *ends = refined(judge.sides, [pose, *_apart(rivals, SAME_START)], 1, SIGMA)
    return any(min(pose_distance(end, pose), pose_distance(end, own)) > APART_AMBIGUOUS for end in ends)


def is_ambiguous(ranked: list[tuple[End, float]], gap: float) -> bool:
    """Whether a clearly different pose explains the clouds as well as the first."""
    return bool(_rivals(ranked, gap))


def _rivals(ranked: list[tuple[End, float]], gap: float) -> list[Array]:
    """The clearly different poses that explain the clouds as well as the first."""
    best, value = ranked[0]
    return [
        end.pose
        for end, other in ranked[1:]
        if value - other < gap and pose_distance(best.pose, end.pose) > APART_AMBIGUOUS
    ]
