"""Which of many poses to believe: how well each explains both clouds at the finest scale at which they know their
shape.

A loose fit of everything beats the exact fit of a half while the mixtures are wide, and every end of EM has a width of
its own. So all poses are compared at the finest scale at which one half of a cloud still explains the other, and at
finer ones, where noise and sampling decide unless the same points were sampled; each by what suits it best, as with the
share of points without a partner. Covariances that are thin across the surface make it a matter of normals too. Where
viewpoints are known, points that one sensor has seen through count against a pose.
"""

from __future__ import annotations

import itertools
import math
from functools import cached_property

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.colour import ColourEstimate
from adagmm_o3d.em.runs import Limits, Start, inverse_of, run_starts
from adagmm_o3d.mixtures.merging import MergedMixture
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.spacing import spacing_of
from adagmm_o3d.sampling import distinct_places, quantile, some_of
from adagmm_o3d.trust.agreement import HELD, LEAST_POINTS, Surface, agreement, surfaces_of
from adagmm_o3d.trust.free_space import RangeImage

# Points of either cloud that are asked.
JUDGED = 1000
# The finest scale of all: along the surface the mixtures are as wide as this share of the spacing of these points.
FINEST = 0.5
# The scales, each so many times the one before, and the last.
COARSER, COARSEST = 2.0, 0.1
# By so many steps from the finest scale the shape may still be known.
SHARP = 2
# The share of points that may have no partner, and the evidence that one half of a cloud has to find for the other
# [nats per point, both together].
UNMATCHED, KNOWN_SHAPE = 0.4, 1.0
# What may suit a pose best: σ, in units of the scale at which the shape is known, and that share. A share of 0.8 lets a
# pose off that leaves most of two Kinect scenes unexplained: three of twenty were lost by it.
SUITED = ((1.0, UNMATCHED), (1.0, 0.6), (0.06, 0.6))
# A pose may be right that explains this share of what the halves of a cloud do: clouds that lack two ends of a room
# share the rest.
KNOWN_AGAIN = 0.5
# And beside another one, that share of what the other explains: of bodies of which either cloud lacks another end, the
# halves lie on each other turned by half a turn as well, and in more of them.
AGAINST = 0.25
# And that holds no less than another one, but for so much: with the handle of a mug on the other side less holds.
ALIKE_HELD = 0.01
# A pose that explains the clouds so many times as well as the halves of one explain each other is certain: the same
# points were sampled. Round and regular bodies, of which another pose may do as well, do not come to this.
CERTAIN = 2.0
# How much coarser a single pose is looked at.
LENIENT = 4.0
# What it costs a pose if all points of one cloud lie where the other's sensor saw nothing [nats].
VIOLATION = 8.0
# Points that a range image is made of, and that are asked whether they violate it.
IMAGED, ASKED = 20_000, 2000


class Judge:
    """Compares poses between two normalised mixtures; `sides` are at most JUDGED of the points of either.

    viewpoints : from where the source and the target were seen, (3,) each in its own cloud's normalised coordinates, or
    None where that is not known.
    """

    def __init__(
        self,
        source: Mixture,
        target: Mixture,
        sides: tuple[MergedMixture, MergedMixture],
        viewpoints: tuple[Array | None, Array | None] = (None, None),
    ) -> None:
        self.sides = _distinct(sides[0]), _distinct(sides[1])
        self.sigma, self.reference, coarsened = self._finest_scale()
        # Whether the points' own spacing, or nearly, is the scale: where noise hides it, no shape can be recognised.
        self.sharp = coarsened <= SHARP and self.reference >= KNOWN_SHAPE
        self._seen = [
            None if viewpoint is None else RangeImage(_some_points(mixture, IMAGED), viewpoint)
            for mixture, viewpoint in zip((source, target), viewpoints, strict=True)
        ]
        self._asked = [
            np.empty((0, 3)) if seen is None else _some_points(mixture, ASKED)
            for mixture, seen in zip((source, target), self._seen[::-1], strict=True)
        ]

    @property
    def coloured(self) -> bool:
        """Whether colours speak as well."""
        return all(side.colours is not None for side in self.sides)

    def known(self, most: float) -> float:
        """Evidence above which a pose may be right beside one that has `most`. Infinity where that is certain, and with
        colours, as even a pose that they speak against explains half by its shape."""
        return math.inf if self.coloured or most >= CERTAIN * self.reference else KNOWN_AGAIN * self.reference

    @property
    def too_few(self) -> bool:
        """Whether the points of either side are no surface."""
        return min(len(side.points) for side in self.sides) < LEAST_POINTS

    @cached_property
    def surfaces(self) -> tuple[Surface, Surface]:
        """Those of its sides."""
        return surfaces_of(*self.sides)

    def evidence(self, poses: list[Array]) -> Array:
        """(k,) mean log-likelihood of the points, both clouds together, beyond that of having no partner at all [nats].

        Above 0 it is likelier that the clouds overlap as the pose says than that they do not overlap.
        """
        evidence = np.max(
            [_evidence(self.sides, poses, self.sigma, share, unmatched) for share, unmatched in SUITED], axis=0
        )
        for k, pose in enumerate(poses):
            evidence[k] -= VIOLATION * self._violations(pose)
        return evidence

    def held(self, pose: Array) -> float:
        """Of what goes on in one cloud, the share that is on the other at a pose, see `Agreement.held`; 1 of points
        that are too few for a surface."""
        return 1.0 if self.too_few else agreement(*self.surfaces, pose).held

    def may_be_right(self, pose: Array, known: float, beside: float, as_right: float = math.inf) -> bool:
        """Whether a pose has more evidence than `known`, and holds beside another at which so much holds; or with more
        than `as_right`, which is no less, whether as much holds as there.

        Where neither cloud is smooth, as of a street, less than between the halves of one holds at the right pose too.
        """
        evidence = float(self.evidence([pose])[0])
        if not evidence > known:
            return False
        held = self.held(pose)
        return holds(held, beside) or (evidence > as_right and held >= beside - ALIKE_HELD)

    def confidence(self, pose: Array, coarser: float = LENIENT) -> float:
        """The same of one pose as the halves of a cloud are asked, at a scale so many times coarser: by default one at
        which a small bias of a sensor does not matter."""
        return float(_evidence(self.sides, [pose], self.sigma * coarser)[0]) - VIOLATION * self._violations(pose)

    def explained(self, sides: tuple[MergedMixture, MergedMixture], poses: list[Array]) -> Array:
        """(k,) the same of other mixtures in place of its own, at the finest scale; from where they were seen plays no
        part."""
        return _evidence(sides, poses, self.sigma)

    def _violations(self, pose: Array) -> float:
        share = 0.0
        for seen, asked, motion in zip(self._seen[::-1], self._asked, (pose, inverse_of(pose)), strict=True):
            if seen is not None:
                share += seen.violations(asked @ motion[:3, :3].T + motion[:3, 3])
        return share

    def _finest_scale(self) -> tuple[float, float, int]:
        """The finest σ at which the halves of both clouds explain each other, and how well they do."""
        reach = max(spacing_of(side.points) for side in self.sides)
        widest = max(float(quantile(side.largest_variances, 0.5)) for side in self.sides)
        sigma = (FINEST * reach) ** 2 / widest
        halves = [(side.take(slice(0, None, 2)), side.take(slice(1, None, 2))) for side in self.sides]
        for coarsened in itertools.count():
            known = min(float(_evidence(pair, [np.eye(4)], sigma)[0]) for pair in halves)
            if known >= KNOWN_SHAPE or sigma * COARSER > COARSEST:
                return sigma, known, coarsened
            sigma *= COARSER
        raise AssertionError


def of_rival(known: float, own: float) -> float:
    """Evidence above which a pose is a rival of one that has `own`; see `Judge.known`."""
    return min(known, AGAINST * own) if known < math.inf else known


def holds(held: float, beside: float = 0.0) -> bool:
    """Whether so much holds as between the halves of a cloud, and no less than at a pose `beside`."""
    return held >= max(HELD[1], beside - ALIKE_HELD)


def _distinct(side: MergedMixture) -> MergedMixture:
    """Without points that are given again, of which one half of a cloud would know too well where the others are."""
    first = distinct_places(side.points)
    return side if len(first) == len(side.points) else side.take(np.sort(first))


def _some_points(mixture: Mixture, count: int) -> Array:
    return mixture.points_at(some_of(np.arange(len(mixture)), count))


def _evidence(
    sides: tuple[MergedMixture, MergedMixture],
    poses: list[Array],
    sigma: float,
    finer: float = 1.0,
    unmatched: float = UNMATCHED,
) -> Array:
    """The likelihood of EM of no iterations, at `finer` times σ; points without a partner are as dense as at σ.

    Where both sides have colours, each pose with what it makes of these.
    """
    starts = [Start(pose, finer * sigma, unmatched, fastest=1.0, iterations=0, follow=1.0) for pose in poses]
    limits = Limits(finer * sigma, unmatched, 0.0)
    if sides[0].colours is None or sides[1].colours is None:
        ends = run_starts(*sides, starts, limits=limits, level=0, compared_at=sigma)
    else:
        estimate, ends = ColourEstimate(*sides), []
        for start in starts:
            colour = estimate.first(start.pose, finer * sigma, unmatched)
            ends += run_starts(*sides, [start], limits=limits, level=0, compared_at=sigma, colour=colour)
    return np.array([end.log_likelihood for end in ends])
