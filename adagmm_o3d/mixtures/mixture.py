"""A point cloud as a Gaussian mixture: one component per point, checked at the door."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import NoReturn, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adagmm_o3d.arguments import Array, float_array
from adagmm_o3d.errors import InputError
from adagmm_o3d.kernels.limits import EPSILON, ROUNDING, SMALLEST, THINNEST
from adagmm_o3d.mixtures.checks import (
    check_count,
    check_not_empty,
    check_spread,
    check_usable,
    far_points,
    refuse_asymmetric,
    refuse_indefinite,
    typical_variance,
)
from adagmm_o3d.principal import principal_axes, principal_variances

# A factor between these costs a variance no digit.
FACTORS = (1e-100, 1e100)
# The attributes in which a mixture keeps what is made of it.
KEPT = "_kept_for", "_last_normalised"
# Where xx, xy, xz, yy, yz and zz stand in a matrix read row by row.
PACKED = np.array([0, 1, 2, 4, 5, 8])

Made = TypeVar("Made")


@dataclass(frozen=True)
class Mixture:
    """Points, covariances and weights of one cloud, float64; 2D lies in the plane z = 0.

    points : (n, 3).   covariances : (n, 3, 3), positive definite (in 2D the block xx, xy, yy; zz is 1).
    weights : (n,) > 0.   dimension : 2 or 3.   isotropic : every covariance is a multiple of the identity.
    kept : (size of the input,) bool, False where a point or its covariance was not finite, or the point far beyond all
        others, and is not in the mixture.
    regularised : how many of the input's covariances were singular.   colours : (n, 3), see `colours`, or None.
    """

    points: Array
    covariances: Array
    weights: Array
    dimension: int
    isotropic: bool
    kept: NDArray[np.bool_]
    regularised: int = 0
    colours: Array | None = None

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
            self.regularised,
            None if self.colours is None else self.colours[index],
        )
        known = {
            name: self.__dict__[name][index] for name in ("variances", "largest_variances") if name in self.__dict__
        }
        return taken.knowing(**known)

    def knowing(self, **known: Array) -> Mixture:
        """Itself, with `variances` and `largest_variances` that need not be found any more."""
        self.__dict__.update(known)
        return self

    def kept_for(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """What `make` makes of this mixture alone, made once and kept with it under `key`.

        A prepared cloud is registered many times, on several threads too: what is made twice is the same, and one of
        the two is kept. Nobody may change it, and it must not hold this mixture, which then nothing would free.
        """
        kept = self.__dict__.setdefault("_kept_for", {})
        if key not in kept:
            kept.setdefault(key, make())
        made: Made = kept[key]
        return made

    def points_at(self, index: NDArray[np.integer]) -> Array:
        """(k, 3) the chosen points."""
        return self.points[index]

    def coloured(self, colours: Array) -> Mixture:
        """The same with colours, (size of the input, 3); it keeps by itself what is made of it."""
        coloured = copy(self)
        for made in KEPT:
            coloured.__dict__.pop(made, None)
        coloured.__dict__["colours"] = np.ascontiguousarray(colours[self.kept])
        return coloured

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
        return principal_variances(self.covariances[:, : self.dimension, : self.dimension])[:, -1]

    def centroid(self, weights: Array) -> Array:
        """(3,) mean of the points with (n,) weights."""
        return np.asarray((self.points * weights[:, None]).sum(axis=0) / weights.sum(), np.float64)

    def radius(self, centre: Array, weights: Array) -> float:
        """Root mean square distance of the points from `centre`, with (n,) weights."""
        squares = ((self.points - centre) ** 2).sum(axis=1)
        return math.sqrt((squares * weights).sum() / weights.sum())

    def normalised(self, centre: Array, scale: float, unit: float, relative: Array) -> Mixture:
        """Points from `centre` in units of `scale`, covariances in units of `unit`, with `relative` (n,) for the
        geometric mean of their variances, which follow from the unit.

        The last one made is kept, with all that is made of it.
        """
        key = centre.tobytes(), scale, unit
        last: tuple[Hashable, Mixture] | None = self.__dict__.get("_last_normalised")
        if last is not None and last[0] == key:
            return last[1]
        mixture = self._normalised(centre, scale, unit, relative)
        self.__dict__["_last_normalised"] = key, mixture
        return mixture

    def _normalised(self, centre: Array, scale: float, unit: float, relative: Array) -> Mixture:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            factor = relative / (self.variances / unit)
            covariances = (self.covariances / unit) * factor[:, None, None]
            largest = self.largest_variances / unit * factor
        # Divided by `unit` some covariances overflow or vanish; divided by their own variance none does.
        extreme = ~(np.isfinite(factor) & (factor > FACTORS[0]) & (factor < FACTORS[1]))
        if extreme.any():
            own, wanted = self.variances[extreme], relative[extreme]
            covariances[extreme] = self.covariances[extreme] / own[:, None, None] * wanted[:, None, None]
            largest[extreme] = self.largest_variances[extreme] / own * wanted
        if self.dimension == 2:
            covariances[:, 2, 2] = 1.0
        points = (self.points - centre) / scale
        mixture = Mixture(
            points,
            covariances,
            self.weights,
            self.dimension,
            self.isotropic,
            self.kept,
            self.regularised,
            self.colours,
        )
        return mixture.knowing(variances=relative, largest_variances=largest)


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
    points : (n, D), D = 2 or 3, any real dtype.   covariances : (n, D, D), or None for the identity at every point. One
    with a variance below THINNEST times its largest is singular: all of its variances become at least EPSILON times
    the largest, and one that is zero becomes isotropic and as large as most are.   weights : (n,) positive, or None for
    ones.

    Raises
    ------
    InputTypeError : not real numbers.   InputError : shape, no point that is finite (those that are not, as organised
    clouds have them where nothing was measured, are dropped and counted), covariances that are not symmetric, have a
    negative eigenvalue beyond rounding, are all zero, or are non-finite at more than 1 % of the points that are finite
    (fewer are dropped and counted, as is what `checks.far_points` finds).
    DegenerateError : fewer than 3 points, or all on one line (3D) or in one place (2D).
    """
    p = float_array(f"{name}.points", points, ("n", (2, 3)), finite=False)
    n, dimension = p.shape
    check_not_empty(name, n)
    c = _check_covariances(name, covariances, n, dimension)
    w = _check_weights(name, weights, n)
    usable = np.full(n, True)
    if not (np.isfinite(p).all() and np.isfinite(c).all()):
        measured = np.asarray(np.isfinite(p).all(axis=1))
        usable = measured & np.isfinite(c).all(axis=(1, 2))
        check_usable(name, measured, usable)
        p, c, w = p[usable], c[usable], w[usable]
    far = far_points(p)
    if far.any():
        usable[usable] = ~far
        p, c, w = p[~far], c[~far], w[~far]
    c, eigenvalues, regularised = _make_definite(name, c, usable)
    check_count(name, usable)
    check_spread(name, p)
    if dimension == 2:
        p, c = _lift(p, c)
    mixture = Mixture(p, c, w, dimension, eigenvalues is None, usable, regularised)
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


def _make_definite(name: str, c: Array, usable: NDArray[np.bool_]) -> tuple[Array, Array | None, int]:
    """Raise unless every covariance is symmetric and positive semidefinite; singular ones are made definite.

    The covariances; their (n, D) eigenvalues, ascending, or None where all are isotropic; how many were singular.
    """
    eigenvalues = None
    if (c == c[:, :1, :1] * np.eye(c.shape[1])).all():
        least = largest = c[:, 0, 0]
    else:
        mirrored = c.transpose(0, 2, 1)
        if not (c == mirrored).all():
            skew = np.abs(c - mirrored).max(axis=(1, 2))
            _refuse(refuse_asymmetric, name, skew > ROUNDING * np.abs(c).max(axis=(1, 2)), usable)
            c = 0.5 * c + 0.5 * mirrored
        eigenvalues = principal_variances(c)
        least, largest = eigenvalues[:, 0], eigenvalues[:, -1]
    _refuse(refuse_indefinite, name, least < -ROUNDING * np.maximum(largest, -least), usable)
    empty = largest < SMALLEST
    flat = (least < THINNEST * largest) & ~empty
    if not (empty.any() or flat.any()):
        return c, eigenvalues, 0
    c = c.copy()
    if empty.any():
        variance = typical_variance(name, largest)
        c[empty] = variance * np.eye(c.shape[1])
        if eigenvalues is not None:
            eigenvalues[empty] = variance
    if eigenvalues is not None:
        c[flat], eigenvalues[flat] = _thickened(c[flat])
    return c, eigenvalues, int(empty.sum() + flat.sum())


def _refuse(refuse: Callable[..., NoReturn], name: str, bad: NDArray[np.bool_], usable: NDArray[np.bool_]) -> None:
    """Refuse covariances if any is bad, by its place in the input."""
    if bad.any():
        refuse(name, np.flatnonzero(usable)[bad])


def _thickened(c: Array) -> tuple[Array, Array]:
    """Covariances with no principal variance below EPSILON times the largest, as in Generalized ICP, and these."""
    variances, axes = principal_axes(c)
    variances = np.maximum(variances, EPSILON * variances[:, -1:])
    return (axes * variances[:, None, :]) @ axes.transpose(0, 2, 1), variances


def _lift(p: Array, c: Array) -> tuple[Array, Array]:
    points, covariances = np.zeros((len(p), 3)), np.zeros((len(p), 3, 3))
    points[:, :2], covariances[:, :2, :2] = p, c
    covariances[:, 2, 2] = 1.0
    return points, covariances
