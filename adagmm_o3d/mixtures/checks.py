"""What is wrong with a cloud, said in one line; the same for clouds on the host and on a GPU."""

from __future__ import annotations

import math
import sys
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import LARGEST_COORDINATE, Array, check_coordinates
from adagmm_o3d.errors import DegenerateError, InputError
from adagmm_o3d.kernels.limits import SMALLEST
from adagmm_o3d.sampling import quantile, some_of

MIN_POINTS = 3
# A sensor model may fail at a point now and then (the Kinect data has one in thousands); more is a mistake upstream.
MAX_NONFINITE_SHARE = 0.01
# Squares of coordinates [input units] must not vanish; nor may they overflow, see `arguments.LARGEST_COORDINATE`.
SMALLEST_EXTENT = 1e-140
# The spread of so few points is measured exactly, see `check_spread`, and none of them is far from all others.
FEW_POINTS = 50
# The bulk of a cloud: this share of its points, found on a sample of at most so many. Where others put the root mean
# square distance from the median to SPREAD times that within which the bulk lies, those beyond FAR times it were never
# measured there (a zero for no return, a wild echo): no sensor sees most of its points so near and a few so far.
BULK, BULK_SAMPLE = 0.9, 20_000
SPREAD, FAR = 3.0, 30.0


def check_not_empty(name: str, count: int) -> None:
    """Raise if there is no point at all."""
    if count == 0:
        raise InputError(f"{name}.points: the cloud is empty; registration needs at least {MIN_POINTS} points")


def check_usable(name: str, measured: NDArray[np.bool_], usable: NDArray[np.bool_]) -> None:
    """Raise if too many of the points that are finite (`measured`) have covariances that are not, or none is."""
    if not measured.any():
        raise InputError(f"{name}.points: not one of the {len(measured)} points is finite")
    dropped = np.flatnonzero(measured & ~usable)
    if len(dropped) > MAX_NONFINITE_SHARE * measured.sum():
        raise InputError(
            f"{name}.covariances: {len(dropped)} of {measured.sum()} are not finite, the first at index {dropped[0]}; "
            f"at most {MAX_NONFINITE_SHARE:.0%} may be (those points are ignored)"
        )


def refuse_asymmetric(name: str, bad: NDArray[np.integer]) -> NoReturn:
    """Raise for covariances that are not symmetric."""
    raise InputError(f"{name}.covariances: not symmetric at index {bad[0]} ({len(bad)} in all)")


def refuse_indefinite(name: str, bad: NDArray[np.integer]) -> NoReturn:
    """Raise for covariances that have a negative variance in some direction."""
    raise InputError(
        f"{name}.covariances: not positive semidefinite at index {bad[0]} ({len(bad)} in all); "
        "no covariance has a negative eigenvalue"
    )


def typical_variance(name: str, largest: Array) -> float:
    """The median of the variances above zero, for points whose own are all zero.

    `largest` (n,) are the largest variances of all points. Raises if there is none above zero.
    """
    positive = largest[largest >= SMALLEST]
    if len(positive) == 0:
        raise InputError(f"{name}.covariances: all {len(largest)} are zero; leave them out if nothing is known")
    return float(np.median(positive))


def check_count(name: str, usable: NDArray[np.bool_]) -> None:
    """Raise if too few points are left."""
    count = int(usable.sum())
    if count < MIN_POINTS:
        points = "1 point" if count == 1 else f"{count} points"
        ignored = len(usable) - count
        rest = f" ({ignored} more {'is' if ignored == 1 else 'are'} not finite)" if ignored else ""
        raise DegenerateError(f"{name}.points: {points} cannot fix a pose; at least {MIN_POINTS} are needed{rest}")


def far_points(p: Array) -> NDArray[np.bool_]:
    """(n,) which of (n, D) points lie so far beyond all others that the scale of the cloud would be theirs."""
    n = len(p)
    low, high = p.min(axis=0, initial=math.inf), p.max(axis=0, initial=-math.inf)
    if n < FEW_POINTS or max(-low.min(), high.max()) > LARGEST_COORDINATE:
        return np.zeros(n, bool)
    middle, bulk = bulk_of(p[some_of(np.arange(n), BULK_SAMPLE)])
    largest = np.maximum(high - middle, middle - low)
    if bulk == 0.0 or float(largest @ largest) <= FAR**2 * bulk:
        return np.zeros(n, bool)
    squares = ((p - middle) ** 2).sum(axis=1)
    far: NDArray[np.bool_] = squares > FAR**2 * bulk
    return far if squares.mean() > SPREAD**2 * bulk else np.zeros(n, bool)


def bulk_of(p: Array) -> tuple[Array, float]:
    """(D,) median of (n, D) points, and the squared distance from it within which BULK of them lie."""
    middle = quantile(p, 0.5)
    return middle, float(quantile(((p - middle) ** 2).sum(axis=1), BULK))


def check_spread(name: str, p: Array) -> None:
    """Points in one place leave the rotation free; in 3D so do points on one line."""
    largest = float(np.abs(p).max())
    check_largest(name, largest)
    centred = p - p[0]
    centred -= centred.sum(axis=0) / len(p)
    extent = float(np.abs(centred).max())
    check_extent(name, extent)
    centred /= max(extent, SMALLEST_EXTENT)
    # Squared singular values would lose a thin direction beside rounding, but are much cheaper for many points.
    spread = np.linalg.svd(centred, compute_uv=False) if len(p) < FEW_POINTS else spread_of(centred.T @ centred)
    check_rank(name, spread, len(p), largest / max(extent, SMALLEST_EXTENT))


def check_largest(name: str, largest: float) -> None:
    """Raise if the squares of the largest coordinate [input units] overflow."""
    check_coordinates(f"{name}.points", np.array([largest]))


def check_extent(name: str, extent: float) -> None:
    """Raise if the squares of the largest distance from the mean along an axis [input units] vanish."""
    if 0.0 < extent < SMALLEST_EXTENT:
        raise InputError(f"{name}.points: expected an extent of {SMALLEST_EXTENT:g} or more, got {extent:g}; rescale")


def check_ratios(name: str, variances: Array, unit: float) -> None:
    """Raise if a variance divided by the unit overflows or vanishes: a GPU's kernels have no other way to scale it."""
    with np.errstate(over="ignore"):
        ratios = variances / unit
    wrong = np.flatnonzero(~((ratios >= sys.float_info.min) & (ratios <= sys.float_info.max)))
    if len(wrong):
        raise InputError(
            f"{name}.covariances: expected on a GPU variances with a number in units of a good point's, {unit:.3g}, "
            f"got {variances[wrong[0]]:.3g} of point {wrong[0]}; register with device='cpu', or mark_outliers()"
        )


def spread_of(scatter: Array) -> Array:
    """(D,) descending singular values of the offsets whose products add up to `scatter` (D, D)."""
    return np.sqrt(np.maximum(np.linalg.eigvalsh(scatter)[::-1], 0.0))


def check_rank(name: str, spread: Array, count: int, distance: float) -> None:
    """Raise unless the singular values of so many offsets stand out of rounding, `distance` extents from the origin."""
    rounding = 4.0 * sys.float_info.epsilon * math.sqrt(count) * distance
    limit = max(1e-7 * spread[0], rounding)
    rank = sum(extent > limit for extent in spread.tolist())
    if rank < len(spread) - 1:
        shape = "in one place" if rank == 0 else "on one line"
        raise DegenerateError(f"{name}.points: all {count} points are {shape}; a pose cannot be found")
