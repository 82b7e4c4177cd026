"""What a registration found, how it got there and how far to trust it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Generic, NamedTuple, TypeVar

from adagmm_o3d.arguments import Array

Answer = TypeVar("Answer")


class StopReason(StrEnum):
    """Why the EM loop ended."""

    CONVERGED = "converged"
    MAX_ITERATION = "max_iteration reached"
    NO_OVERLAP = "no pair of points carries weight"
    DEGENERATE = "the pairs leave the pose undetermined"


def stop_reason(settled: bool, determined: bool) -> StopReason:
    """Why a loop ended that had pairs with weight, or ran for no iteration; `determined` of its last step."""
    if not determined:
        return StopReason.DEGENERATE
    return StopReason.CONVERGED if settled else StopReason.MAX_ITERATION


class Iteration(NamedTuple):
    """One EM iteration, in normalised coordinates.

    pose (4, 4) after it, σ during it, energy per unit of pair weight, share of the source matched, level (0 coarsest).
    """

    pose: Array
    sigma: float
    energy: float
    matched: float
    level: int = 0


# With a smaller share of partners than this, anything might fit.
LEAST_OVERLAP = 0.1
# Less evidence than this has no right pose of clouds that share two fifths or more, and most chance fits of rooms.
LEAST_EVIDENCE = 0.25
# A pose that is as probably wrong as right, from what is seen of it alone, is not to be trusted.
LEAST_BELIEF = 0.5
# By less than this a pose is no better than one that is turned from there [nats per point].
LEAST_MARGIN = 0.1


@dataclass(frozen=True)
class Partners:
    """overlap : share of the source's points that have a partner.   row_weights : (M,) the probability of each."""

    overlap: float
    row_weights: Array


@dataclass(frozen=True)
class PoseUncertainty:
    """covariance : (6, 6), in 2D (3, 3), of δ = (ω, v) in exp(δ)·T; None where no pair carries any weight.

    unobservable : unit tangent directions that the shape leaves free.
    """

    covariance: Array | None
    unobservable: tuple[Array, ...]


@dataclass(frozen=True)
class Verdict:
    """What speaks for a pose; None of what so few points cannot tell.

    evidence : see `PointRegistrationResult.evidence`.   share : of the points of both clouds, those that lie on the
    other's surface.   held : of those that lie where the other's surface goes on, the share on it, in units of that
    share between the halves of one cloud.   margin : by how much the pose explains the clouds better than one that is
    turned from there by half a turn or a quarter [nats per point], where that was looked at; infinity where all of
    these are the same.   scale : factor by which the source would have to be scaled, where its size is clearly another
    one, else None.   over_image : by how much the pose explains the clouds better than the mirror image of the source
    does, where that was looked at; 0 where an image that does better says nothing.   mirrored : whether that fits so
    clearly better that it must be one.   repeats : whether slid along itself the shape fits as well, so that there are
    several such poses; looked at where this one is believed.   tilt : by how much the clouds are tilted against each
    other [rad], where gravity held the pose and they clearly are, else None.   belief : the probability that the pose
    is right.
    """

    evidence: float
    share: float | None = None
    held: float | None = None
    margin: float | None = None
    scale: float | None = None
    over_image: float | None = None
    mirrored: bool = False
    repeats: bool = False
    tilt: float | None = None
    belief: float | None = None


@dataclass(frozen=True)
class ColorFit:
    """What the pairs say of colours: how far two looks at the same place differ, in CIE L*a*b* (of intensities only the
    first coordinate counts, scaled to 0..100).

    deviations : (3,) standard deviations.   lying : share of the pairs that look different none the less (highlights,
    shadows).   gain, offset : (3,) gain · source + offset is how the target's sensor sees a colour of the source's.
    """

    deviations: Array
    lying: float
    gain: Array
    offset: Array


class Deferred(Generic[Answer]):
    """An answer that is worked out when it is first asked for; what it is made from is let go then."""

    def __init__(self, work_out: Callable[[], Answer]) -> None:
        self._work_out: Callable[[], Answer] | None = work_out

    def __call__(self) -> Answer:
        work_out = self._work_out
        if work_out is not None:
            self._answer = work_out()
            self._work_out = None
        return self._answer

    def __reduce__(self) -> tuple[Any, ...]:
        """Copied and pickled as the answer itself: the clouds it is made from need not come along."""
        return _answered, (self(),)


def _answered(answer: Answer) -> Deferred[Answer]:
    deferred = Deferred(lambda: answer)
    deferred()  # so that nothing is left to be worked out, and it pickles again
    return deferred


@dataclass(frozen=True, eq=False)
class PointRegistrationResult:
    """The pose that moves `source` onto `target`, and the EM's own record of the way there.

    transformation : (D+1, D+1), source → target, input units.
    stop_reason, converged : why the loop ended; converged only when the pose had stopped moving at the final σ.
    iterations : EM iterations K on the way from the start that won, on all levels; `max_iteration` at most. No
        more than a third of that is the coarse levels', the last ones there: what came before only found the start.
    sigmas : (K,) the scale of the mixtures in each iteration: σ·Σ is a covariance in input units², Σ as given. The
        rule "figure2" scales the source's alone.
    energies : (K,) the paper's Eq. 5 in each iteration, in squared Mahalanobis distances, per unit of pair weight.
    transformations : (K+1, D+1, D+1) the pose before the first iteration and after each. The first is where the search
        left off or that of the start that won it, which need not be `init`.
    dropped_source, dropped_target : points ignored because they or their covariances are not finite, or because they
        lie so far beyond all others that they cannot have been measured there.
    regularised_source, regularised_target : points whose covariance was singular and was given some thickness.
    ambiguous : another, clearly different pose explains the clouds as well. Only a global search can tell.
    doubts : one line for each reason not to trust the result that the registration itself came upon.
    color : what was learnt of the colours; None where they were not looked at.
    compare_colors : see `color_support`; as the three that follow.
    find_partners, assess, weigh : what the final pose says of the points, its uncertainty, and how well it explains the
        clouds. They cost about as much as one iteration on all points and as some, so they run when something of theirs
        is first asked for: the first for `overlap` and `row_weights`, the second for `pose_covariance` and
        `unobservable`, the third for `evidence`, `belief` and `scale`, all for `warnings`. Until then the clouds are
        kept for them.
    """

    transformation: Array
    stop_reason: StopReason
    iterations: int
    sigmas: Array
    energies: Array
    transformations: Array
    dropped_source: int
    dropped_target: int
    regularised_source: int
    regularised_target: int
    ambiguous: bool
    doubts: tuple[str, ...]
    find_partners: Deferred[Partners]
    assess: Deferred[PoseUncertainty]
    weigh: Deferred[Verdict | None]
    color: ColorFit | None = None
    compare_colors: Deferred[Array] | None = None

    @property
    def color_support(self) -> Array | None:
        """(M,) how much the colours speak for the partners of each source point [nats]: above 0 these are likelier to
        be the same place by what they look like, below 0 less. NaN where there are no partners; None where colours were
        not looked at."""
        return None if self.compare_colors is None else self.compare_colors()

    @property
    def overlap(self) -> float:
        """Estimated share of the source's points that have a partner in the target, 0 to 1."""
        return self.find_partners().overlap

    @property
    def row_weights(self) -> Array:
        """(M,) probability of each source point to have a partner; 0 where it was dropped."""
        return self.find_partners().row_weights

    @property
    def pose_covariance(self) -> Array | None:
        """(6, 6), in 2D (3, 3), of δ = (ω, v) in exp(δ)·T [rad, input units]; see the module `pose_covariance`.

        A free direction has a standard deviation of one radius. None for the paper's own rules and where no pair has
        any weight. Its inverse is the information matrix of an edge for an optimiser that takes errors as they are
        (g2o, GTSAM). Open3D's `global_optimization` reads the number of corresponding pairs out of an edge's matrix, to
        judge which edges to drop: give it that of `evaluation.information_matrix`, or its own function's.
        """
        return self.assess().covariance

    @property
    def unobservable(self) -> tuple[Array, ...]:
        """Unit tangent directions (ω, v), in normalised coordinates (about the target's centroid, lengths in radii of
        the clouds), that the points leave free."""
        return self.assess().unobservable

    @property
    def evidence(self) -> float | None:
        """Mean log-likelihood of the points at the final pose, both clouds together, beyond that of having no partner
        at all [nats per point], at a scale four times the finest at which the clouds know their own shape. Below
        LEAST_EVIDENCE a chance fit does as well. None where no pair has any weight."""
        verdict = self.weigh()
        return None if verdict is None else verdict.evidence

    @property
    def belief(self) -> float | None:
        """The probability that the pose is right, where as many are wrong: from how far the surfaces agree where
        either goes on, and whether a turn or the mirror image does as well; see the module `trust.verdict`. None where
        `evidence` is, and for clouds of less than thirty points."""
        verdict = self.weigh()
        return None if verdict is None else verdict.belief

    @property
    def scale(self) -> float | None:
        """The factor by which the source would have to be scaled to fit the target, where their sizes clearly differ;
        the pose is rigid all the same. None where they do not, or where the clouds share too little to tell."""
        verdict = self.weigh()
        return None if verdict is None else verdict.scale

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each reason not to trust the result; empty when there is none."""
        reasons = list(self.doubts)
        if self.overlap < LEAST_OVERLAP:
            reasons.append(f"the estimated overlap is only {self.overlap:.0%}")
        if (verdict := self.weigh()) is not None:
            reasons += _objections(verdict)
        if free := len(self.unobservable):
            reasons.append(f"the shape leaves {free} direction{'s' if free > 1 else ''} of the pose free")
        return tuple(reasons)

    @property
    def converged(self) -> bool:
        """Whether the pose had stopped moving at the final σ."""
        return self.stop_reason is StopReason.CONVERGED

    @property
    def trustworthy(self) -> bool:
        """Whether nothing speaks against the pose: it converged, is observable and not ambiguous."""
        return not self.warnings

    @property
    def sigma(self) -> float:
        """The final scale of the mixtures; σ·Σ is a covariance in input units². 0 if there was no iteration."""
        return float(self.sigmas[-1]) if self.iterations else 0.0


def _objections(verdict: Verdict) -> list[str]:
    reasons = []
    if verdict.evidence < LEAST_EVIDENCE:
        reasons.append("the clouds explain each other no better than a chance fit would")
    elif verdict.mirrored:
        reasons.append("the mirror image of the source fits better: one of the clouds has an axis the wrong way round")
    elif verdict.belief is not None and verdict.belief < LEAST_BELIEF:
        if verdict.margin is not None and verdict.margin < LEAST_MARGIN:
            reasons.append("turned from here the clouds fit as well or better: a nearly symmetric shape")
        else:
            reasons.append(
                "where the clouds meet they agree too little: the pose is right with a probability of "
                f"{verdict.belief:.0%}"
            )
    if verdict.repeats:
        reasons.append("slid from here the clouds fit as well: a shape that repeats itself")
    if verdict.tilt is not None:
        reasons.append(
            f"the clouds are tilted by {math.degrees(verdict.tilt):.0f}° against each other: they fit better if turned "
            "otherwise than about gravity"
        )
    if verdict.scale is not None:
        reasons.append(
            f"the clouds are of different sizes: the source fits if it is scaled by {verdict.scale:.3f} before"
        )
    return reasons
