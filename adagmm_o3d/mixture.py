"""A point cloud as a Gaussian mixture: one component per point, checked at the door and brought to a common scale."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .arguments import Array, float_array
from .errors import DegenerateError, InputError
from .order_statistics import quantile

MIN_POINTS = 3
# A sensor model may fail at a point now and then (the Kinect data has one in thousands); more is a mistake upstream.
MAX_NONFINITE_SHARE = 0.01
# Half of all points may be flagged outliers: the unit of variance is that of a point among the best.
GOOD_SHARE = 0.125
# A variance this many times the unit is a flag more than a measurement.
VAGUE = 100.0
# What the kernels' float32 can tell apart: variances relative to the unit, and the least one of a point to its largest.
VARIANCE_RANGE = (1e-6, 1e12)
THINNEST = 1e-6
# The share of a cloud that must be seen as more than a dot, and how small that is, in radii.
BULK, FINEST = 0.9, 1e-3
# Clouds this many radii apart do not see each other, and float32 has no digits for more.
FARTHEST = 1e4
# Squares of coordinates [input units] must neither overflow nor vanish.
LARGEST_COORDINATE, SMALLEST_EXTENT = 1e140, 1e-140
PACKED = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


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

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> Mixture:
        """The mixture of the chosen components."""
        return Mixture(
            self.points[index],
            self.covariances[index],
            self.weights[index],
            self.dimension,
            self.isotropic,
            self.kept,
        )

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
        packed = np.stack([self.covariances[:, i, j] for i, j in PACKED])
        if self.dimension == 2:
            packed[5] = 0.0
        return packed

    def packed_precisions(self) -> Array:
        """(6, n) inverse covariances, packed as xx, xy, xz, yy, yz, zz; in 2D what has a z is zero."""
        precisions = np.linalg.inv(self.covariances)
        if self.dimension == 2:
            precisions[:, 2, 2] = 0.0
        return np.stack([precisions[:, i, j] for i, j in PACKED])

    @cached_property
    def largest_variances(self) -> Array:
        """(n,) the largest eigenvalue of each covariance: how far the point reaches."""
        if self.isotropic:
            return self.covariances[:, 0, 0].copy()
        return np.asarray(np.linalg.eigvalsh(self.covariances[:, : self.dimension, : self.dimension])[:, -1], np.float64)


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
    if n == 0:
        raise InputError(f"{name}.points: the cloud is empty; registration needs at least {MIN_POINTS} points")
    if not np.isfinite(p).all():
        bad = np.flatnonzero(~np.isfinite(p).all(axis=1))
        raise InputError(
            f"{name}.points: {len(bad)} of {n} points are not finite, the first at index {bad[0]}; "
            "remove them first, e.g. with PointCloud.remove_non_finite_points()"
        )
    c = _check_covariances(name, covariances, n, dimension)
    w = _check_weights(name, weights, n)
    usable: NDArray[np.bool_] = np.asarray(np.isfinite(c).all(axis=(1, 2)))
    dropped = int(n - usable.sum())
    if dropped > MAX_NONFINITE_SHARE * n:
        first = int(np.flatnonzero(~usable)[0])
        raise InputError(
            f"{name}.covariances: {dropped} of {n} are not finite, the first at index {first}; "
            f"at most {MAX_NONFINITE_SHARE:.0%} may be (those points are ignored)"
        )
    p, c, w = p[usable], c[usable], w[usable]
    isotropic = _check_positive_definite(name, c, usable)
    if len(p) < MIN_POINTS:
        raise DegenerateError(f"{name}.points: {len(p)} points cannot fix a pose; at least {MIN_POINTS} are needed")
    _check_spread(name, p)
    if dimension == 2:
        p, c = _lift(p, c)
    return Mixture(np.ascontiguousarray(p), np.ascontiguousarray(c), w, dimension, isotropic, usable)


def _check_covariances(name: str, covariances: ArrayLike | None, n: int, dimension: int) -> Array:
    if covariances is None:
        return np.broadcast_to(np.eye(dimension), (n, dimension, dimension)).copy()
    return float_array(f"{name}.covariances", covariances, (n, dimension, dimension), finite=False).copy()


def _check_weights(name: str, weights: ArrayLike | None, n: int) -> Array:
    if weights is None:
        return np.ones(n)
    w = float_array(f"{name}.weights", weights, (n,))
    if not (w > 0).all():
        first = int(np.flatnonzero(w <= 0)[0])
        raise InputError(f"{name}.weights: expected numbers above zero, got {w[first]:g} at index {first}")
    return w


def _check_positive_definite(name: str, c: Array, usable: NDArray[np.bool_]) -> bool:
    """Raise unless every covariance is symmetric positive definite; returns whether all are isotropic."""
    index = np.flatnonzero(usable)
    dimension = c.shape[1]
    diagonal = np.einsum("nii->ni", c)
    off = c[:, ~np.eye(dimension, dtype=bool)]
    if (off == 0).all() and (diagonal == diagonal[:, :1]).all():
        bad = np.flatnonzero(diagonal[:, 0] <= 0)
        isotropic = True
    else:
        scale = np.abs(c).max(axis=(1, 2))
        skew = np.abs(c - c.transpose(0, 2, 1)).max(axis=(1, 2))
        crooked = np.flatnonzero(skew > 1e-5 * scale)
        if len(crooked):
            raise InputError(f"{name}.covariances: not symmetric at index {index[crooked[0]]} ({len(crooked)} in all)")
        c[:] = 0.5 * c + 0.5 * c.transpose(0, 2, 1)
        eigenvalues = np.linalg.eigvalsh(c)
        bad = np.flatnonzero(eigenvalues[:, 0] <= 1e-12 * eigenvalues[:, -1])
        isotropic = False
        thin = np.flatnonzero(eigenvalues[:, 0] < THINNEST * eigenvalues[:, -1])
        if not len(bad) and len(thin):
            c[thin] = _thickened(c[thin])
    if len(bad):
        raise InputError(
            f"{name}.covariances: not positive definite at index {index[bad[0]]} ({len(bad)} in all); "
            "add a small multiple of the identity"
        )
    return isotropic


def _thickened(c: Array) -> Array:
    """Covariances with no principal variance below THINNEST times the largest."""
    variances, axes = np.linalg.eigh(c)
    variances = np.maximum(variances, THINNEST * variances[:, -1:])
    return (axes * variances[:, None, :]) @ axes.transpose(0, 2, 1)


def _check_spread(name: str, p: Array) -> None:
    """Points in one place leave the rotation free; in 3D so do points on one line."""
    largest = float(np.abs(p).max())
    if largest > LARGEST_COORDINATE:
        raise InputError(f"{name}.points: expected coordinates up to {LARGEST_COORDINATE:g}, got {largest:g}; rescale")
    centred = p - p[0]
    centred -= centred.mean(axis=0)
    extent = float(np.abs(centred).max())
    if 0.0 < extent < SMALLEST_EXTENT:
        raise InputError(f"{name}.points: expected an extent of {SMALLEST_EXTENT:g} or more, got {extent:g}; rescale")
    centred /= max(extent, SMALLEST_EXTENT)
    # Squared singular values would lose a thin direction beside rounding, but are much cheaper for many points.
    spread = (
        np.linalg.svd(centred, compute_uv=False)
        if len(p) < 50
        else np.sqrt(np.maximum(np.linalg.eigvalsh(centred.T @ centred)[::-1], 0.0))
    )
    rounding = 4.0 * np.finfo(float).eps * math.sqrt(len(p)) * largest / max(extent, SMALLEST_EXTENT)
    rank = int((spread > max(1e-7 * spread[0], rounding)).sum())
    if rank < p.shape[1] - 1:
        shape = "in one place" if rank == 0 else "on one line"
        raise DegenerateError(f"{name}.points: all {len(p)} points are {shape}; a pose cannot be found")


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
    relative = [np.clip(v / unit, *VARIANCE_RANGE) for v in variances]
    centres = [np.average(m.points, axis=0, weights=m.weights / r) for m, r in zip(sides, relative, strict=True)]
    certain = [r <= VAGUE if (r <= VAGUE).any() else np.full(len(r), True) for r in relative]
    radii = [
        np.sqrt(np.average(((m.points[k] - c) ** 2).sum(axis=1), weights=m.weights[k]))
        for m, c, k in zip(sides, centres, certain, strict=True)
    ]
    scale = float(max(radii))
    for name, m, k in zip(("source", "target"), sides, certain, strict=True):
        _check_resolution(name, m.points[k], scale)
    normalised = []
    for m, c, v, r in zip(sides, centres, variances, relative, strict=True):
        covariances = (m.covariances / unit) * (r / (v / unit))[:, None, None]
        if m.dimension == 2:
            covariances[:, 2, 2] = 1.0
        normalised.append(Mixture((m.points - c) / scale, covariances, m.weights, m.dimension, m.isotropic, m.kept))
    return normalised[0], normalised[1], Normalisation(centres[0], centres[1], scale, unit)


def _check_resolution(name: str, points: Array, scale: float) -> None:
    """Raise where a few points far away, or the other cloud, make a dot of a cloud's bulk."""
    bulk = float(quantile(np.linalg.norm(points - quantile(points, 0.5), axis=1), BULK))
    if bulk < FINEST * scale:
        raise InputError(
            f"{name}.points: {BULK:.0%} lie within {bulk:.3g} of their median, but the radius of the clouds is "
            f"{scale:.3g}; check the units, remove far points or mark_outliers()"
        )
