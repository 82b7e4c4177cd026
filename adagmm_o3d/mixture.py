"""A point cloud as a Gaussian mixture: one component per point, checked at the door and brought to a common scale."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arguments import Array, float_array
from .cloud_checks import (
    check_count,
    check_not_empty,
    check_spread,
    check_usable,
    refuse_crooked,
    refuse_indefinite,
    refuse_points,
)
from .errors import InputError
from .order_statistics import quantile
from .sampling import some_of

# Half of all points may be flagged outliers: the unit of variance is that of a point among the best.
GOOD_SHARE = 0.125
# A variance this many times the unit is a flag more than a measurement.
VAGUE = 100.0
# What the kernels' float32 can tell apart: variances relative to the unit, and the least one of a point to its largest.
VARIANCE_RANGE = (1e-6, 1e12)
THINNEST = 1e-6
# Entries may differ from their mirror images by this share of the largest; a variance below that one is none.
SKEW, LEAST_POSITIVE = 1e-5, 1e-12
# The share of a cloud that must be seen as more than a dot, and how small that is, in radii.
BULK, FINEST = 0.9, 1e-3
# Of larger clouds that many points are asked for it.
BULK_FROM = 20_000
# Clouds this many radii apart do not see each other, and float32 has no digits for more.
FARTHEST = 1e4
# Where xx, xy, xz, yy, yz and zz stand in a matrix read row by row.
PACKED = np.array([0, 1, 2, 4, 5, 8])


@dataclass(frozen=True)
class Mixture:
    """Points, covariances and weights of one cloud, float64; 2D lies in the plane z = 0.

    points : (n, 3).   covariances : (n, 3, 3), positive definite (in 2D the block xx, xy, yy; zz is 1).
    weights : (n,) > 0.   dimension : 2 or 3.   isotropic : every covariance is a multiple of the identity.
    kept : (size of the input,) bool, False where a point had a non-finite covariance and is not in the mixture.
    """

    points: Array
    covariances: Array
    weights: Array
    dimension: int
    isotropic: bool
    kept: NDArray[np.bool_]

    @property
    def on_device(self) -> bool:
        """Whether the points lie on a GPU."""
        return False

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> Mixture:
        """The mixture of the chosen components."""
        taken = Mixture(
            self.points[index],
            self.covariances[index],
            self.weights[index],
            self.dimension,
            self.isotropic,
            self.kept,
        )
        known = {
            name: self.__dict__[name][index] for name in ("variances", "largest_variances") if name in self.__dict__
        }
        return taken.knowing(**known)

    def knowing(self, **known: Array) -> Mixture:
        """Itself, with `variances` and `largest_variances` that need not be found any more."""
        self.__dict__.update(known)
        return self

    def points_at(self, index: NDArray[np.integer]) -> Array:
        """(k, 3) the chosen points."""
        return self.points[index]

    @property
    def dropped(self) -> int:
        """How many input points are not in the mixture."""
        return int(len(self.kept) - self.kept.sum())

    @cached_property
    def variances(self) -> Array:
        """(n,) geometric mean of the principal variances, |Σ|^(1/D): one number for how vague a point is."""
        if self.isotropic:
            return self.covariances[:, 0, 0].copy()
        return np.exp(np.linalg.slogdet(self.covariances).logabsdet / self.dimension)

    def packed_covariances(self) -> Array:
        """(6, n) covariances, packed as xx, xy, xz, yy, yz, zz; in 2D what has a z is zero."""
        return packed(self.covariances, self.dimension)

    def packed_precisions(self) -> Array:
        """(6, n) inverse covariances, packed as xx, xy, xz, yy, yz, zz; in 2D what has a z is zero."""
        return packed(np.asarray(np.linalg.inv(self.covariances), np.float64), self.dimension)

    @cached_property
    def largest_variances(self) -> Array:
        """(n,) the largest eigenvalue of each covariance: how far the point reaches."""
        if self.isotropic:
            return self.covariances[:, 0, 0].copy()
        return _principal_variances(self.covariances[:, : self.dimension, : self.dimension])[:, -1]

    def centroid(self, weights: Array) -> Array:
        """(3,) mean of the points with (n,) weights."""
        return np.asarray((self.points * weights[:, None]).sum(axis=0) / weights.sum(), np.float64)

    def radius(self, centre: Array, weights: Array) -> float:
        """Root mean square distance of the points from `centre`, with (n,) weights."""
        squares = ((self.points - centre) ** 2).sum(axis=1)
        return math.sqrt((squares * weights).sum() / weights.sum())

    def normalised(self, centre: Array, scale: float, unit: float, relative: Array) -> Mixture:
        """Points from `centre` in units of `scale`, covariances in units of `unit`, with `relative` (n,) for the
        geometric mean of their variances."""
        factor = relative / (self.variances / unit)
        covariances = (self.covariances / unit) * factor[:, None, None]
        if self.dimension == 2:
            covariances[:, 2, 2] = 1.0
        points = (self.points - centre) / scale
        mixture = Mixture(points, covariances, self.weights, self.dimension, self.isotropic, self.kept)
        return mixture.knowing(variances=relative, largest_variances=self.largest_variances / unit * factor)


def packed(matrices: Array, dimension: int) -> Array:
    """(6, n) of (n, 3, 3) symmetric matrices, as xx, xy, xz, yy, yz, zz; in 2D zz is zero."""
    entries = matrices.reshape(-1, 9).T.take(PACKED, axis=0)
    if dimension == 2:
        entries[5] = 0.0
    return entries


def make_mixture(
    name: str, points: ArrayLike, covariances: ArrayLike | None, weights: ArrayLike | None = None
) -> Mixture:
    """Check one cloud and lift it into three dimensions.

    Parameters
    ----------
    name : "source" or "target"; begins every error message.
    points : (n, D), D = 2 or 3, any real dtype.   covariances : (n, D, D), or None for the identity at every point; one
    with a variance below THINNEST times its largest is thickened to that.   weights : (n,) positive, or None for ones.

    Raises
    ------
    InputTypeError : not real numbers.   InputError : shape, non-finite points, covariances that are not symmetric
    positive definite, or non-finite at more than 1 % of the points (fewer are dropped and counted).
    DegenerateError : fewer than 3 points, or all on one line (3D) or in one place (2D).
    """
    p = float_array(f"{name}.points", points, ("n", (2, 3)), finite=False)
    n, dimension = p.shape
    check_not_empty(name, n)
    if not np.isfinite(p).all():
        refuse_points(name, np.flatnonzero(~np.isfinite(p).all(axis=1)), n)
    c = _check_covariances(name, covariances, n, dimension)
    w = _check_weights(name, weights, n)
    finite, usable = np.isfinite(c), np.full(n, True)
    if not finite.all():
        usable = np.asarray(finite.all(axis=(1, 2)))
        check_usable(name, usable)
        p, c, w = p[usable], c[usable], w[usable]
    c, eigenvalues = _check_positive_definite(name, c, usable)
    check_count(name, len(p))
    check_spread(name, p)
    if dimension == 2:
        p, c = _lift(p, c)
    mixture = Mixture(p, c, w, dimension, eigenvalues is None, usable)
    if eigenvalues is not None:
        variances = (eigenvalues ** (1.0 / dimension)).prod(axis=1)
        mixture.knowing(variances=variances, largest_variances=eigenvalues[:, -1].copy())
    return mixture


def _check_covariances(name: str, covariances: ArrayLike | None, n: int, dimension: int) -> Array:
    if covariances is None:
        return np.tile(np.eye(dimension), (n, 1, 1))
    return float_array(f"{name}.covariances", covariances, (n, dimension, dimension), finite=False)


def _check_weights(name: str, weights: ArrayLike | None, n: int) -> Array:
    if weights is None:
        return np.ones(n)
    w = float_array(f"{name}.weights", weights, (n,)).copy()
    if not (w > 0).all():
        first = int(np.flatnonzero(w <= 0)[0])
        raise InputError(f"{name}.weights: expected numbers above zero, got {w[first]:g} at index {first}")
    return w


def _check_positive_definite(name: str, c: Array, usable: NDArray[np.bool_]) -> tuple[Array, Array | None]:
    """Raise unless every covariance is symmetric positive definite; thin ones come back thickened.

    The covariances and their (n, D) eigenvalues, ascending, or None where all are isotropic.
    """
    if (c == c[:, :1, :1] * np.eye(c.shape[1])).all():
        _refuse(refuse_indefinite, name, c[:, 0, 0] <= 0.0, usable)
        return c, None
    mirrored = c.transpose(0, 2, 1)
    if not (c == mirrored).all():
        skew = np.abs(c - mirrored).max(axis=(1, 2))
        _refuse(refuse_crooked, name, skew > SKEW * np.abs(c).max(axis=(1, 2)), usable)
        c = 0.5 * c + 0.5 * mirrored
    eigenvalues = _principal_variances(c)
    least, largest = eigenvalues[:, 0], eigenvalues[:, -1]
    thin = least <= THINNEST * largest
    if thin.any():
        _refuse(refuse_indefinite, name, least <= LEAST_POSITIVE * largest, usable)
        c = c.copy()
        c[thin], eigenvalues[thin] = _thickened(c[thin])
    return c, eigenvalues


def _refuse(refuse: Callable[..., NoReturn], name: str, bad: NDArray[np.bool_], usable: NDArray[np.bool_]) -> None:
    """Refuse covariances if any is bad, by its place in the input."""
    if bad.any():
        refuse(name, np.flatnonzero(usable)[bad])


def _principal_variances(c: Array) -> Array:
    """(n, D) ascending eigenvalues of (n, D, D) covariances."""
    if c.shape[1] == 3:
        return np.asarray(np.linalg.eigvalsh(c), np.float64)
    xx, xy, yy = c[:, 0, 0], c[:, 0, 1], c[:, 1, 1]
    mean, deviation = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    eigenvalues = np.empty((len(c), 2))
    eigenvalues[:, 0], eigenvalues[:, 1] = mean - deviation, mean + deviation
    return eigenvalues


def _thickened(c: Array) -> tuple[Array, Array]:
    """Covariances with no principal variance below THINNEST times the largest, and their eigenvalues."""
    variances, axes = np.linalg.eigh(c)
    variances = np.maximum(variances, THINNEST * variances[:, -1:])
    return (axes * variances[:, None, :]) @ axes.transpose(0, 2, 1), variances


def _lift(p: Array, c: Array) -> tuple[Array, Array]:
    points, covariances = np.zeros((len(p), 3)), np.zeros((len(p), 3, 3))
    points[:, :2], covariances[:, :2, :2] = p, c
    covariances[:, 2, 2] = 1.0
    return points, covariances


@dataclass(frozen=True)
class Normalisation:
    """The similarity that brings both clouds to their centroids and to unit radius (the paper, Section 4.1).

    Normalised p is (p - centre) / scale; `scale` is the larger of the two RMS radii [input units]. Covariances, which
    are relative, are divided by `variance`, a low percentile over both clouds: that of a good point becomes 1.
    """

    source_centre: Array
    target_centre: Array
    scale: float
    variance: float

    def sigma_out(self, sigma: float) -> float:
        """σ of the normalised mixtures → σ for the covariances as given, [input units² per unit of covariance]."""
        return sigma * self.scale**2 / self.variance

    def pose_in(self, transformation: Array) -> Array:
        """(4, 4) input pose → the same pose between normalised clouds, brought to within FARTHEST if farther apart."""
        pose = transformation.copy()
        offset = transformation[:3, :3] @ self.source_centre + transformation[:3, 3] - self.target_centre
        largest = float(np.abs(offset).max())
        if largest > FARTHEST * self.scale:
            offset *= FARTHEST * self.scale / largest
        pose[:3, 3] = offset / self.scale
        return pose

    def pose_out(self, pose: Array) -> Array:
        """(4, 4) or (k, 4, 4) poses between normalised clouds → the same between the input clouds."""
        out = pose.copy()
        out[..., :3, 3] = pose[..., :3, 3] * self.scale + self.target_centre - pose[..., :3, :3] @ self.source_centre
        return out


def normalise(source: Mixture, target: Mixture) -> tuple[Mixture, Mixture, Normalisation]:
    """Both mixtures with their own centroid at the origin, the larger RMS radius 1 and covariances of unit scale.

    A point counts for the centroid as far as it is certain; flagged outliers do not count for the radius either.

    Raises
    ------
    InputError : a cloud that is hardly more than a dot at that scale.
    """
    sides = (source, target)
    variances = [m.variances for m in sides]
    unit = float(quantile(np.concatenate(variances), GOOD_SHARE))
    relative = [np.minimum(np.maximum(v / unit, VARIANCE_RANGE[0]), VARIANCE_RANGE[1]) for v in variances]
    centres = [m.centroid(m.weights / r) for m, r in zip(sides, relative, strict=True)]
    certain = [_certain(r) for r in relative]
    scale = max(m.radius(c, m.weights * k) for m, c, k in zip(sides, centres, certain, strict=True))
    for name, m, k in zip(("source", "target"), sides, certain, strict=True):
        _check_resolution(name, _some_points(m, np.flatnonzero(k)), scale)
    moving, fixed = (m.normalised(c, scale, unit, r) for m, c, r in zip(sides, centres, relative, strict=True))
    return moving, fixed, Normalisation(centres[0], centres[1], scale, unit)


def _certain(relative: Array) -> NDArray[np.bool_]:
    """(n,) which points are not flagged as outliers; all where every one is."""
    certain: NDArray[np.bool_] = relative <= VAGUE
    return certain if certain.any() else ~certain


def _some_points(mixture: Mixture, index: NDArray[np.intp]) -> Array:
    """The points at `index`, of many BULK_FROM."""
    return mixture.points_at(some_of(index, BULK_FROM))


def _check_resolution(name: str, points: Array, scale: float) -> None:
    """Raise where a few points far away, or the other cloud, make a dot of a cloud's bulk."""
    bulk = math.sqrt(quantile(((points - quantile(points, 0.5)) ** 2).sum(axis=1), BULK))
    if bulk < FINEST * scale:
        raise InputError(
            f"{name}.points: {BULK:.0%} lie within {bulk:.3g} of their median, but the radius of the clouds is "
            f"{scale:.3g}; check the units, remove far points or mark_outliers()"
        )
