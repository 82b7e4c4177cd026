"""What a registration found, how it got there and how far to trust it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from .arguments import Array


class StopReason(StrEnum):
    """Why the EM loop ended."""

    CONVERGED = "converged"
    MAX_ITERATION = "max_iteration reached"
    NO_OVERLAP = "no pair of points carries weight"
    DEGENERATE = "the pairs leave the pose undetermined"


@dataclass(frozen=True, eq=False)
class PointRegistrationResult:
    """The pose that moves `source` onto `target`, and the EM's own record of the way there.

    transformation : (D+1, D+1), source → target, input units.
    stop_reason, converged : why the loop ended; converged only when the pose had stopped moving at the final σ.
    iterations : EM iterations K on the way from the start that won, on all levels.
    sigmas : (K,) the scale of the mixtures in each iteration: σ·Σ is a covariance in input units², Σ as given. The
        rule "figure2" scales the source's alone.
    energies : (K,) the paper's Eq. 5 in each iteration, in squared Mahalanobis distances, per unit of pair weight.
    transformations : (K+1, D+1, D+1) the pose before the first iteration and after each. The first is that of the start
        that won the search, which need not be `init`.
    overlap : estimated share of the source's points that have a partner in the target, 0 to 1.
    row_weights : (M,) probability of each source point to have a partner; 0 where it was dropped.
    dropped_source, dropped_target : points ignored because their covariance is not finite.
    pose_covariance : (6, 6), in 2D (3, 3), of δ = (ω, v) in exp(δ)·T [rad, input units]; see `pose_covariance`. A free
        direction has a standard deviation of one radius. None where it was not asked for or no pair has any weight.
        Its inverse is the information matrix of a pose graph's edge.
    unobservable : unit tangent directions (ω, v), in normalised coordinates (about the target's centroid, lengths in
        radii of the clouds), that the points leave free.
    ambiguous : another, clearly different pose explains the clouds as well. Only a global search can tell.
    warnings : one line for each reason not to trust the result; empty when there is none.
    """

    transformation: Array
    stop_reason: StopReason
    iterations: int
    sigmas: Array
    energies: Array
    transformations: Array
    overlap: float
    row_weights: Array
    dropped_source: int
    dropped_target: int
    pose_covariance: Array | None
    unobservable: tuple[Array, ...]
    ambiguous: bool
    warnings: tuple[str, ...]

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
