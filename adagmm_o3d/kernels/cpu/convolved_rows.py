"""Loops over pairs weighed by convolved Gaussians, N(d; 0, Σx + R Σy Rᵀ): the density of x - y at zero.

The pairs are those of the few source points of a cluster with a run i..j, whole tiles, of the packed target. Each loop
comes for full covariances, for those of the plane (z = 0) and for multiples of the identity. `moments` are what the
M-step needs, `densities` is how dense each mixture is at the points of the other.

With colours a pair also weighs how probable these make it that its points are the same place: a Gaussian of their
difference that falls no further than a floor, as some colours lie (a highlight, a shadow). That is a term of the
exponent, so a pair takes no further exponential. Without colours `hue` is None, and Numba compiles the loops without
them.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.compiling import F0, FLAGS, formulas
from adagmm_o3d.kernels.cpu.culling import TILE
from adagmm_o3d.kernels.cpu.row_sums import add_full, add_isotropic
from adagmm_o3d.kernels.layout import (
    DENSITY,
    ENERGY,
    FACTOR,
    HUE,
    ISOTROPIC_FACTOR,
    ISOTROPIC_HUE,
    MATRIX,
    PRECISION,
    PULL,
    SHARE,
    WEIGHT,
    X,
)

convolved_full, convolved_planar = formulas.convolved_full, formulas.convolved_planar
convolved_isotropic = formulas.convolved_isotropic
capped_distance, density_of = formulas.capped_distance, formulas.density_of

# Loops over two indices, a row and a point, become vector code because neither can count from the end: one is a
# constant, one unsigned.
WHOLE = np.uint64(TILE)


class Cluster(NamedTuple):
    """The `size` points of a source cluster as they lie at a pose: y (3, CLUSTER), matrices (CLUSTER, 6) at σ, weights
    (CLUSTER,)."""

    size: int
    y: NDArray[np.float32]
    matrices: NDArray[np.float32]
    weights: NDArray[np.float32]


class Hues(NamedTuple):
    """Colours of points (3, n), in units in which the weight of a pair halves where they differ by one, and `cap`, the
    squared difference at which it falls no further."""

    colours: NDArray[np.float32]
    cap: np.float32


@njit(**FLAGS)
def whole_tiles(i, j):
    """How many points i..j are, said so that the compiler knows that no part of a vector is left over."""
    return np.uint64(j - i) // WHOLE * WHOLE


@njit(**FLAGS)
def hue_of(hue, k):
    """The colour of source point k, nothing where colours do not count."""
    if hue is None:
        return F0, F0, F0
    return hue.colours[0, k], hue.colours[1, k], hue.colours[2, k]


@njit(**FLAGS)
def exponent_of(q, hue, own, target, at, n):
    """q, and how unlike the colour `own` is to that of target point n, which is at `at`, where colours count."""
    if hue is None:
        return q
    return q + capped_distance(own[0], own[1], own[2], target[at, n], target[at + 1, n], target[at + 2, n], hue.cap)


@njit(**FLAGS)
def moments_full(target, i, j, cluster, hue, rows):
    """Add to `rows` (layout.ROW_SUMS, CLUSTER) the pairs of a `Cluster`, `hue` its `Hues` or None."""
    count, y, turned, _ = cluster
    first = np.uint64(i)
    for k in range(count):
        y0, y1, y2 = y[0, k], y[1, k], y[2, k]
        b0, b1, b2, b3, b4, b5 = turned[k, 0], turned[k, 1], turned[k, 2], turned[k, 3], turned[k, 4], turned[k, 5]
        w = F0
        e = F0
        density = F0
        p0 = F0
        p1 = F0
        p2 = F0
        p3 = F0
        p4 = F0
        p5 = F0
        u0 = F0
        u1 = F0
        u2 = F0
        own_hue = hue_of(hue, k)
        for m in range(whole_tiles(i, j)):
            n = first + m
            dx = y0 - target[X, n]
            dy = y1 - target[X + 1, n]
            dz = y2 - target[X + 2, n]
            height, inverse, q, vx, vy, vz, c0, c1, c2, c3, c4, c5 = convolved_full(
                target[SHARE, n],
                dx,
                dy,
                dz,
                target[MATRIX, n] + b0,
                target[MATRIX + 1, n] + b1,
                target[MATRIX + 2, n] + b2,
                target[MATRIX + 3, n] + b3,
                target[MATRIX + 4, n] + b4,
                target[MATRIX + 5, n] + b5,
            )
            exponent = exponent_of(q, hue, own_hue, target, HUE, n)
            factor = target[FACTOR, n]
            g = density_of(height, exponent)
            density += g
            c = g * factor
            f = g * (factor * inverse)
            w += c
            e += c * q
            p0 += f * c0
            p1 += f * c1
            p2 += f * c2
            p3 += f * c3
            p4 += f * c4
            p5 += f * c5
            u0 += f * vx
            u1 += f * vy
            u2 += f * vz
        add_full(rows, k, w, e, p0, p1, p2, p3, p4, p5, u0, u1, u2)
        rows[DENSITY, k] += density


@njit(**FLAGS)
def moments_planar(target, i, j, cluster, hue, rows):
    """The same in the plane."""
    count, y, turned, _ = cluster
    first = np.uint64(i)
    for k in range(count):
        y0, y1 = y[0, k], y[1, k]
        b0, b1, b3 = turned[k, 0], turned[k, 1], turned[k, 3]
        w = F0
        e = F0
        density = F0
        p0 = F0
        p1 = F0
        p3 = F0
        u0 = F0
        u1 = F0
        own_hue = hue_of(hue, k)
        for m in range(whole_tiles(i, j)):
            n = first + m
            dx = y0 - target[X, n]
            dy = y1 - target[X + 1, n]
            s0 = target[MATRIX, n] + b0
            s1 = target[MATRIX + 1, n] + b1
            s3 = target[MATRIX + 3, n] + b3
            height, inverse, q, vx, vy = convolved_planar(target[SHARE, n], dx, dy, s0, s1, s3)
            exponent = exponent_of(q, hue, own_hue, target, HUE, n)
            factor = target[FACTOR, n]
            g = density_of(height, exponent)
            density += g
            c = g * factor
            f = g * (factor * inverse)
            w += c
            e += c * q
            p0 += f * s3
            p1 -= f * s1
            p3 += f * s0
            u0 += f * vx
            u1 += f * vy
        rows[WEIGHT, k] += w
        rows[ENERGY, k] += e
        rows[PRECISION, k] += p0
        rows[PRECISION + 1, k] += p1
        rows[PRECISION + 3, k] += p3
        rows[PULL, k] += u0
        rows[PULL + 1, k] += u1
        rows[DENSITY, k] += density


@njit(**FLAGS)
def moments_isotropic(target, i, j, planar, cluster, hue, rows):
    """The same where every covariance is a multiple of the identity."""
    count, y, turned, _ = cluster
    first = np.uint64(i)
    for k in range(count):
        y0, y1, y2, b = y[0, k], y[1, k], y[2, k], turned[k, 0]
        w = F0
        e = F0
        density = F0
        p = F0
        u0 = F0
        u1 = F0
        u2 = F0
        own_hue = hue_of(hue, k)
        for m in range(whole_tiles(i, j)):
            n = first + m
            dx = y0 - target[X, n]
            dy = y1 - target[X + 1, n]
            dz = y2 - target[X + 2, n]
            height, precision, q = convolved_isotropic(target[SHARE, n], dx, dy, dz, target[MATRIX, n] + b, planar)
            exponent = exponent_of(q, hue, own_hue, target, ISOTROPIC_HUE, n)
            factor = target[ISOTROPIC_FACTOR, n]
            g = density_of(height, exponent)
            density += g
            c = g * factor
            f = g * (factor * precision)
            w += c
            e += c * q
            p += f
            u0 += f * dx
            u1 += f * dy
            u2 += f * dz
        add_isotropic(rows, k, w, e, p, u0, u1, u2)
        rows[DENSITY, k] += density


@njit(**FLAGS)
def densities_full(target, i, j, cluster, hue, columns, rows):
    """Add the target's density at source points `y` of weights `own` to `rows`, and theirs at its points to `columns`
    (as long as the target), each times the weight of the target point."""
    count, y, turned, own = cluster
    first = np.uint64(i)
    for k in range(count):
        y0, y1, y2, weight = y[0, k], y[1, k], y[2, k], own[k]
        b0, b1, b2, b3, b4, b5 = turned[k, 0], turned[k, 1], turned[k, 2], turned[k, 3], turned[k, 4], turned[k, 5]
        density = F0
        own_hue = hue_of(hue, k)
        for m in range(whole_tiles(i, j)):
            n = first + m
            dx = y0 - target[X, n]
            dy = y1 - target[X + 1, n]
            dz = y2 - target[X + 2, n]
            height, _, q, _, _, _, _, _, _, _, _, _ = convolved_full(
                target[SHARE, n],
                dx,
                dy,
                dz,
                target[MATRIX, n] + b0,
                target[MATRIX + 1, n] + b1,
                target[MATRIX + 2, n] + b2,
                target[MATRIX + 3, n] + b3,
                target[MATRIX + 4, n] + b4,
                target[MATRIX + 5, n] + b5,
            )
            exponent = exponent_of(q, hue, own_hue, target, HUE, n)
            g = density_of(height, exponent)
            density += g
            columns[n] += weight * g
        rows[DENSITY, k] += density


@njit(**FLAGS)
def densities_planar(target, i, j, cluster, hue, columns, rows):
    """The same in the plane."""
    count, y, turned, own = cluster
    first = np.uint64(i)
    for k in range(count):
        y0, y1, weight = y[0, k], y[1, k], own[k]
        b0, b1, b3 = turned[k, 0], turned[k, 1], turned[k, 3]
        density = F0
        own_hue = hue_of(hue, k)
        for m in range(whole_tiles(i, j)):
            n = first + m
            dx = y0 - target[X, n]
            dy = y1 - target[X + 1, n]
            height, _, q, _, _ = convolved_planar(
                target[SHARE, n], dx, dy, target[MATRIX, n] + b0, target[MATRIX + 1, n] + b1, target[MATRIX + 3, n] + b3
            )
            exponent = exponent_of(q, hue, own_hue, target, HUE, n)
            g = density_of(height, exponent)
            density += g
            columns[n] += weight * g
        rows[DENSITY, k] += density


@njit(**FLAGS)
def densities_isotropic(target, i, j, planar, cluster, hue, columns, rows):
    """The same where every covariance is a multiple of the identity."""
    count, y, turned, own = cluster
    first = np.uint64(i)
    for k in range(count):
        y0, y1, y2, b, weight = y[0, k], y[1, k], y[2, k], turned[k, 0], own[k]
        density = F0
        own_hue = hue_of(hue, k)
        for m in range(whole_tiles(i, j)):
            n = first + m
            dx = y0 - target[X, n]
            dy = y1 - target[X + 1, n]
            dz = y2 - target[X + 2, n]
            height, _, q = convolved_isotropic(target[SHARE, n], dx, dy, dz, target[MATRIX, n] + b, planar)
            exponent = exponent_of(q, hue, own_hue, target, ISOTROPIC_HUE, n)
            g = density_of(height, exponent)
            density += g
            columns[n] += weight * g
        rows[DENSITY, k] += density
