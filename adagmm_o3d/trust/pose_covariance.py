"""How far the pose that EM found can be trusted: its covariance, and the directions the clouds leave free.

The pose is where the sum of all scores (the pulls of the pairs, see `kernels.cpu.scores`) is zero. Were the clouds
sampled anew, the scores would be others, and the pose would follow: Cov = H⁻¹ B H⁻¹, the sandwich of an M-estimator.
H is the full derivative of the sum, the change of the posteriors included; without that (Gauss-Newton) the covariance
comes out far too small wherever it is open which points belong together. B is the variance of the sum. Points near each
other share errors: a score depends on points of both clouds, neighbours compete for the same partners, and a sensor
errs alike where it sees the same surface. So scores are added up over blocks of space first, for each cloud by itself,
and B is made of these sums (the sandwich for clustered data). EM stops a little before the sum is zero: the step that
is left is an error of its own, which among many points is the larger one.

It covers what is independent from block to block, and nothing else: neither an error that all points of a sensor share,
nor that EM may have ended in a wrong optimum. How honest it is, `adagmm-bench covariance` measures: the normalised
error squared should be 6 on average, in 2D 3; over 550 trials of the simulations it is 5.4 (4.6 to 5.7 in each sweep),
over 546 in 2D 3.4. On twenty Kinect scenes with the isotropic covariances of Eq. 6 its median is 150: the deviations
are a fifth of the errors, of which the ground truth has its part.

Source
------
P. J. Huber: The behavior of maximum likelihood estimates under nonstandard conditions, 1967.   K.-Y. Liang and
S. L. Zeger: Longitudinal data analysis using generalized linear models, Biometrika 73, 1986.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.em.runs import inverse_of
from adagmm_o3d.em.unmatched import uniform_density
from adagmm_o3d.grouping import block_numbers
from adagmm_o3d.kernels.cpu.scores import Hues, Reach, ScoredPoints, score_sums
from adagmm_o3d.kernels.layout import CURVATURE, POINT_SUMS, SCORE, SENSITIVITY
from adagmm_o3d.lie import hat, se_adjoint
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import PACKED, Mixture
from adagmm_o3d.mixtures.normalisation import Normalisation
from adagmm_o3d.pairs.protocol import Pairs
from adagmm_o3d.result import PoseUncertainty
from adagmm_o3d.sampling import some_of
from adagmm_o3d.trust.copies import are_copies
from adagmm_o3d.trust.held_by_colour import free_of_colours
from adagmm_o3d.trust.held_by_detail import free_of_detail
from adagmm_o3d.trust.observability import free_directions, generalised_eigen

# Of at most this many points of a cloud the scores are worked out; their sums stand for those of all points.
SCORED = 1000
# The edge of a block, in radii: beyond the reach of the pairs, and small enough for a hundred blocks on a surface.
BLOCK = 0.25
# Largest squared Mahalanobis distance of a pair: its weight is 4e-6 of that at zero.
CUT = 25.0
# A curvature below this share of the largest holds nothing.
FLAT = 1e-6
# A direction also counts as free when its standard deviation is this share of the radius.
FREE_DEVIATION = 0.2
# The least share of the Gauss-Newton curvature that is left when the weights follow the pose.
LEAST_HELD = 0.05


@dataclass(frozen=True)
class Fit:
    """Where EM ended on two normalised mixtures: pose (4, 4), σ, the share of points without a partner, and the
    mutuality of the posteriors."""

    pose: Array
    sigma: float
    unmatched: float
    mutuality: float
    colour: ColourModel | None = None


def pose_uncertainty(pairs: Pairs, source: Mixture, target: Mixture, fit: Fit) -> PoseUncertainty:
    """The uncertainty of a pose between normalised mixtures; `pairs` are theirs.

    In a direction that the shape and the colours leave free the standard deviation is one radius; see also
    `observability.free_directions`, `held_by_detail.free_of_detail` and `held_by_colour.free_of_colours`.
    """
    scores = score_moments(pairs, source, target, fit)
    if not np.trace(scores.curvature) > 0.0:
        return PoseUncertainty(None, tuple(np.eye(len(scores.curvature))))
    copies = are_copies(source, target, fit.pose)
    free = np.array(() if copies else free_directions(source, fit.pose, scores.matched))
    free = free_of_detail(source, target, fit.pose, free.reshape(-1, len(scores.curvature)))
    if fit.colour is not None:
        free = free_of_colours(source, target, fit.pose, fit.colour, free, scores.matched)
    held = _complement(free)
    # what the curvature does not hold is free as well
    curvature = _held(scores.curvature, scores.hessian)
    values, vectors = np.linalg.eigh(held.T @ curvature @ held)
    flat = values <= FLAT * np.trace(curvature)
    free = np.concatenate([free, (held @ vectors[:, flat]).T])
    held, values = held @ vectors[:, ~flat], values[~flat]
    ahead = (held / values) @ (held.T @ scores.left)
    covariance = (held / values) @ _variance(held, scores) @ (held / values).T + np.outer(ahead, ahead)
    deviations, directions = np.linalg.eigh(covariance)
    unsure = directions[:, deviations > FREE_DEVIATION**2]
    return PoseUncertainty(covariance + free.T @ free, (*free, *unsure.T))


def uncertainty_out(
    pairs: Pairs, source: Mixture, target: Mixture, fit: Fit, normalisation: Normalisation, *, inverse: bool = False
) -> PoseUncertainty:
    """`pose_uncertainty` with the covariance in input units; with `inverse`, of the inverse pose, from what is the
    caller's target to the caller's source."""
    normalised = pose_uncertainty(pairs, source, target, fit)
    if inverse:
        normalised = _of_inverse(normalised, fit.pose, source.dimension)
    if normalised.covariance is None:
        return normalised
    return PoseUncertainty(covariance_out(normalised.covariance, normalisation), normalised.unobservable)


def _of_inverse(uncertainty: PoseUncertainty, pose: Array, dimension: int) -> PoseUncertainty:
    """That of the inverse of `pose` (4, 4): (exp(δ) T)⁻¹ = exp(-Ad(T⁻¹) δ) T⁻¹."""
    change = se_adjoint(inverse_of(pose))[np.ix_(FREE[dimension], FREE[dimension])]
    covariance, free = uncertainty.covariance, uncertainty.unobservable
    if covariance is not None:
        covariance = change @ covariance @ change.T
    return PoseUncertainty(covariance, tuple(np.linalg.qr(change @ np.array(free).T)[0].T) if free else free)


def _complement(directions: Array) -> Array:
    """(k, k - f) orthonormal columns perpendicular to the f given orthonormal rows."""
    return np.linalg.svd(directions, full_matrices=True)[2][len(directions) :].T


def _variance(held: Array, scores: ScoreMoments) -> Array:
    """(h, h) variance of the sum of all scores along the columns of `held`: that of blocks, or of points where it is
    larger, as by chance with few blocks."""
    points = held.T @ scores.by_points @ held
    growth, motions = generalised_eigen(held.T @ scores.by_blocks @ held, points)
    outward = points @ motions
    return outward @ (np.maximum(growth, 1.0)[:, None] * outward.T)


@dataclass(frozen=True)
class ScoreMoments:
    """Sums over the scores g of points and of blocks at a pose; k = 6, in 2D 3.

    curvature : (k, k) derivative of the sum of all scores by the pose.   hessian : (k, k) the same with the weights of
    the pairs held.   by_points : (k, k) Σ g gᵀ over the points, the
    mean of both clouds'.   by_blocks : the same over blocks.   left : (k,) the sum of all scores.   matched : (M,)
    probability of a partner.
    """

    curvature: Array
    hessian: Array
    by_points: Array
    by_blocks: Array
    left: Array
    matched: Array


def score_moments(pairs: Pairs, source: Mixture, target: Mixture, fit: Fit) -> ScoreMoments:
    """The scores of the points of both clouds at a pose."""
    uniform = uniform_density(fit.unmatched, fit.sigma, source.dimension)
    sums = pairs.posterior_sums(fit.pose, fit.sigma, uniform, fit.mutuality, fit.colour)
    source_weights, target_weights = source.weights / source.weights.sum(), target.weights / target.weights.sum()
    # 1 / (density + uniform), for the source points from the probability to have a partner
    source_rest = (1.0 - sums.row_weights) / uniform
    target_rest = 1.0 / (sums.column_densities + uniform)
    make_side, axis = (_ResidentSide, 0) if source.on_device else (_side, int(np.argmax(np.ptp(target.points, axis=0))))
    moved = make_side(source, fit, fit.pose, source_weights * source_rest ** (1.0 - fit.mutuality), axis)
    still = make_side(target, fit, np.eye(4), target_weights * target_rest**fit.mutuality, axis)
    curvature, by_points, by_blocks = np.zeros((3, 6, 6))
    sides = (
        (moved, still, source_rest, target_weights, 1.0 - fit.mutuality),
        (still, moved, target_rest, source_weights, fit.mutuality),
    )
    # A cloud of nothing but flagged outliers has no scores.
    for own, other, rest, shares, exponent in sides if len(moved.index) and len(still.index) else ():
        chosen, growth = _chosen(own)
        part = own.take(chosen)
        if isinstance(other, _ResidentSide):
            rows = other.score_sums(part, shares, own is moved, pairs)
        else:
            rows = _score_sums(part, other, shares, own is moved, fit, source.dimension == 2, axis)
        score = rows[:, SCORE:SENSITIVITY]
        change = rows[:, SENSITIVITY:CURVATURE] * rest[part.index, None]
        curvature += growth * exponent * score.T @ change
        if own is moved:
            curvature += growth * rows[:, CURVATURE:].sum(axis=0).reshape(6, 6)
        points, block = score.T @ score, _block_sums(part.points, score)
        by_points += 0.5 * growth * points
        # Of the products between two points of a block a share of 1/growth² was seen.
        between = block.T @ block - points
        if growth > 1.0:
            between = _positive_part(between, points)
        by_blocks += 0.5 * (growth * points + growth**2 * between)
    free = np.ix_(FREE[source.dimension], FREE[source.dimension])
    left = sums.gradient[FREE[source.dimension]]
    curvature = 0.5 * (curvature + curvature.T)[free]
    return ScoreMoments(curvature, sums.hessian[free], by_points[free], by_blocks[free], left, sums.row_weights)


def _positive_part(between: Array, points: Array) -> Array:
    """Sums of products between points without what is negative in units of those of points: multiplied by how many
    points each seen one stands for, it would outgrow them, and no variance is negative."""
    growth, motions = generalised_eigen(between, points)
    outward = points @ motions
    return outward @ (np.maximum(growth, 0.0)[:, None] * outward.T)


def _held(curvature: Array, hessian: Array) -> Array:
    """The curvature, where it is no less than LEAST_HELD of what the pairs hold with their weights fixed.

    The change of the weights takes some of that away; by chance of the sampling, more than there is.
    """
    shares, motions = generalised_eigen(curvature, hessian)
    outward = hessian @ motions
    return outward @ (np.maximum(shares, LEAST_HELD)[:, None] * outward.T)


def covariance_out(covariance: Array, normalisation: Normalisation) -> Array:
    """(k, k) covariance of a pose between normalised clouds → the same in input units [rad, input units].

    exp(δ) at the normalised target is exp(δ') at the input, with ω' = ω and v' = scale · v + centre x ω: a turn about
    the target's centre moves the origin.
    """
    dimension = 2 if len(covariance) == 3 else 3
    turns = len(covariance) - dimension
    change = np.eye(len(covariance))
    change[turns:, turns:] *= normalisation.scale
    change[turns:, :turns] = hat(normalisation.target_centre)[:dimension, 3 - turns :]
    return change @ covariance @ change.T


@dataclass(frozen=True)
class _Side:
    """One cloud as the kernel wants it, along its longest axis; `index` are the points' places in the mixture."""

    points: Array
    covariances: Array
    variances: Array
    weights: Array
    index: NDArray[np.intp]
    colours: Array | None

    def take(self, index: NDArray[np.intp]) -> _Side:
        return _Side(
            self.points[index],
            self.covariances[index],
            self.variances[index],
            self.weights[index],
            self.index[index],
            None if self.colours is None else self.colours[index],
        )

    def scored(self) -> ScoredPoints:
        return ScoredPoints(self.points, self.covariances, self.variances, self.weights)


def _side(mixture: Mixture, fit: Fit, pose: Array, weights: Array, axis: int) -> _Side:
    """The components of a mixture that are not flagged as outliers, at `pose`, in the order of a coordinate."""
    index = np.flatnonzero(mixture.variances <= FLAGGED)
    points = mixture.points[index] @ pose[:3, :3].T + pose[:3, 3]
    order = np.argsort(points[:, axis], kind="stable")
    index, points = index[order], points[order]
    covariances = fit.sigma * pose[:3, :3] @ mixture.covariances[index] @ pose[:3, :3].T
    return _Side(
        points,
        covariances.reshape(-1, 9).take(PACKED, axis=1),
        fit.sigma * mixture.largest_variances[index],
        weights[index],
        index,
        None if mixture.colours is None else mixture.colours[index],
    )


def _chosen(own: _Side | _ResidentSide) -> tuple[NDArray[np.intp], float]:
    """Which points are looked at, and how many each of them stands for."""
    chosen = some_of(np.arange(len(own.index)), SCORED)
    return chosen, len(own.index) / max(1, len(chosen))


def _block_sums(points: Array, scores: Array) -> Array:
    """(blocks, 6) sums of the (n, 6) scores of the points in each cube of edge BLOCK."""
    block = block_numbers(points, BLOCK)
    return np.stack([np.bincount(block, weights=score) for score in scores.T], axis=1)


def _score_sums(
    own: _Side, other: _Side, shares: Array, own_is_source: bool, fit: Fit, planar: bool, axis: int
) -> Array:
    """(n, POINT_SUMS) of the points of `own`."""
    reach = np.sqrt(CUT * (own.variances + other.variances.max()))
    sorted_axis = np.ascontiguousarray(other.points[:, axis])
    windows = np.stack([np.searchsorted(sorted_axis, own.points[:, axis] + side * reach) for side in (-1.0, 1.0)])
    sums = np.empty((len(own.index), POINT_SUMS))
    hues = None
    if fit.colour is not None:
        assert own.colours is not None and other.colours is not None
        hues = Hues(
            fit.colour.scaled(own.colours, of_source=own_is_source),
            fit.colour.scaled(other.colours, of_source=not own_is_source),
            fit.colour.floor,
            fit.colour.expected,
        )
    within = Reach(windows, CUT)
    score_sums(own.scored(), other.scored(), shares[other.index], within, own_is_source, planar, sums, hues)
    return sums


class _ResidentSide:
    """The same for a cloud that lies on a GPU and stays there, but for the points whose scores are looked at."""

    def __init__(self, mixture: Mixture, fit: Fit, pose: Array, weights: Array, axis: int) -> None:
        self._mixture, self._fit, self._pose, self._axis = mixture, fit, pose, axis
        certain = mixture.variances <= FLAGGED
        self._weights, self.index = np.where(certain, weights, 0.0), np.flatnonzero(certain)

    def take(self, index: NDArray[np.intp]) -> _Side:
        places = self.index[index]
        part = _side(self._mixture.take(places), self._fit, self._pose, self._weights[places], self._axis)
        return replace(part, index=places[part.index])

    def score_sums(self, own: _Side, shares: Array, own_is_source: bool, pairs: Any) -> Array:
        """(n, POINT_SUMS) of the points of `own`, which belong to the other cloud."""
        points = np.concatenate([own.points.T, own.covariances.T, own.variances[None]]).astype(np.float32)
        rows = pairs.score_sums(
            self._fit.pose,
            self._fit.sigma,
            points,
            own_is_source,
            self._weights,
            np.where(self._weights > 0.0, shares, 0.0),
            CUT,
            self._fit.colour,
            own.colours,
        )
        rows[:, :SENSITIVITY] *= own.weights[:, None]
        rows[:, CURVATURE:] *= own.weights[:, None]
        return rows
