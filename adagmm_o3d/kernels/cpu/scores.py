"""The score of each point: the pull of all its pairs on the pose, and how that changes with the pose.

What the pose covariance is made of. Pairs are those of `convolution_sums`, in float64, and only those of chosen points
of one cloud with all of the other, so that memory stays that of the points.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cpu.compiling import FLAGS, KERNEL_FLAGS, formulas, source_stamp
from adagmm_o3d.kernels.layout import CURVATURE, SCORE, SENSITIVITY

dot, cross, symmetric_product = formulas.dot, formulas.cross, formulas.symmetric_product
convolved_full = formulas.convolved_full
capped_distance = formulas.capped_distance


class ScoredPoints(NamedTuple):
    """Points (n, 3), packed covariances (n, 6), largest variances and weights (n,). Those of the source are moved,
    their covariances turned."""

    points: Array
    covariances: Array
    variances: Array
    weights: Array


class Reach(NamedTuple):
    """Which pairs count: windows (2, K), the first point of the other cloud that each of K points looks at and the one
    past the last; cut, the largest squared Mahalanobis distance."""

    windows: NDArray[np.int64]
    cut: float


class Hues(NamedTuple):
    """Colours of the K points and of the n others, (K, 3) and (n, 3), whose squared difference is an exponent; cap, the
    most that it can be; expected, the mean of the exponential over unrelated pairs, see `mixtures.colours`."""

    own: Array
    other: Array
    cap: float
    expected: float


class Likelihood(NamedTuple):
    """Of one pair: its weight, per unit of c; what its colours make of c, 1 without any; and the share of the other
    point in the density at this one."""

    weight: float
    of_colours: float
    share: float


class Room(NamedTuple):
    """Work space: S⁻¹ (3, 3), the slope of S⁻¹ d (3, 3), the gradient j (6,), and the change of the density (6,)."""

    inverse: Array
    slope: Array
    j: Array
    change: Array


@njit(**FLAGS)
def add_pair(source, target, planar, cut, likelihood, curved, room, row):
    """Add one pair to `row` (POINT_SUMS); source and target are each a point (3,) and its packed covariance (6,).

    likelihood, room : `Likelihood`, `Room`.   cut : see `Reach`.   curved : whether CURVATURE is wanted, which is the
    same sum for both clouds.
    """
    (y, b), (x, a) = source, target
    weight, likeness, share = likelihood
    inverse, slope, j, change = room
    dx, dy, dz = y[0] - x[0], y[1] - x[1], y[2] - x[2]
    s5 = 1.0 if planar else a[5] + b[5]
    height, scale, q, vx, vy, vz, c0, c1, c2, c3, c4, c5 = convolved_full(
        1.0, dx, dy, dz, a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], s5
    )
    if q > cut:
        return
    density = likeness * height * math.exp(-0.5 * q)
    vx, vy, vz = vx * scale, vy * scale, vz * scale
    c0, c1, c2, c3, c4, c5 = c0 * scale, c1 * scale, c2 * scale, c3 * scale, c4 * scale, c5 * scale
    w = weight * density
    j[0], j[1], j[2] = cross(y[0], y[1], y[2], vx, vy, vz)
    j[3], j[4], j[5] = vx, vy, vz
    # S turns with the source: ∂S/∂ω_k = [e_k]ₓ B + B [e_k]ₓᵀ. With pull = B v, -∂(log c)/∂δ = j + (turn, 0).
    px, py, pz = symmetric_product(b[0], b[1], b[2], b[3], b[4], b[5], vx, vy, vz)
    tx, ty, tz = cross(px, py, pz, vx, vy, vz)
    # B S⁻¹, column by column
    _, f10, f20 = symmetric_product(b[0], b[1], b[2], b[3], b[4], b[5], c0, c1, c2)
    f01, _, f21 = symmetric_product(b[0], b[1], b[2], b[3], b[4], b[5], c1, c3, c4)
    f02, f12, _ = symmetric_product(b[0], b[1], b[2], b[3], b[4], b[5], c2, c4, c5)
    change[0] = j[0] + f12 - f21 - tx
    change[1] = j[1] + f20 - f02 - ty
    change[2] = j[2] + f01 - f10 - tz
    change[3], change[4], change[5] = vx, vy, vz
    for k in range(6):
        row[SCORE + k] += w * j[k]
        row[SENSITIVITY + k] += share * density * change[k]
    if not curved:
        return
    inverse[0, 0], inverse[0, 1], inverse[0, 2] = c0, c1, c2
    inverse[1, 0], inverse[1, 1], inverse[1, 2] = c1, c3, c4
    inverse[2, 0], inverse[2, 1], inverse[2, 2] = c2, c4, c5
    # slope = S ∂(S⁻¹ d)/∂δ: for the shift the identity, for the turn -[y - B v]ₓ - B [v]ₓ, column by column.
    gx, gy, gz = px - y[0], py - y[1], pz - y[2]
    bx, by, bz = symmetric_product(b[0], b[1], b[2], b[3], b[4], b[5], 0.0, vz, -vy)
    slope[0, 0], slope[1, 0], slope[2, 0] = -bx, gz - by, -gy - bz
    bx, by, bz = symmetric_product(b[0], b[1], b[2], b[3], b[4], b[5], -vz, 0.0, vx)
    slope[0, 1], slope[1, 1], slope[2, 1] = -gz - bx, -by, gx - bz
    bx, by, bz = symmetric_product(b[0], b[1], b[2], b[3], b[4], b[5], vy, -vx, 0.0)
    slope[0, 2], slope[1, 2], slope[2, 2] = gy - bx, -gx - by, -bz
    along = dot(y[0], y[1], y[2], vx, vy, vz)
    for k in range(6):
        if k < 3:
            h0 = inverse[0, 0] * slope[0, k] + inverse[0, 1] * slope[1, k] + inverse[0, 2] * slope[2, k]
            h1 = inverse[1, 0] * slope[0, k] + inverse[1, 1] * slope[1, k] + inverse[1, 2] * slope[2, k]
            h2 = inverse[2, 0] * slope[0, k] + inverse[2, 1] * slope[1, k] + inverse[2, 2] * slope[2, k]
        else:
            h0, h1, h2 = inverse[0, k - 3], inverse[1, k - 3], inverse[2, k - 3]
        r0, r1, r2 = cross(y[0], y[1], y[2], h0, h1, h2)
        if k < 3:
            # the lever arm turns too: (ω x y) x v = y (ω·v) - ω (y·v)
            r0, r1, r2 = r0 + y[0] * j[3 + k], r1 + y[1] * j[3 + k], r2 + y[2] * j[3 + k]
        for i in range(6):
            h = r0 if i == 0 else r1 if i == 1 else r2 if i == 2 else h0 if i == 3 else h1 if i == 4 else h2
            if i == k and k < 3:
                h -= along
            row[CURVATURE + 6 * i + k] += w * (h - j[i] * change[k])


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def score_sums(own, other, shares, within, own_is_source, planar, sums, hues=None):
        """Fill `sums` (K, POINT_SUMS) for the K points of `own` with all points of `other`; for target points only the
        scores and sensitivities.

        own, other : `ScoredPoints`; a pair weighs the product of both weights and of c.   within : `Reach`.
        shares : (n,) what a point of `other` adds to a density, per unit of c.
        hues : `Hues`, or None where colours do not count.
        """
        _ = stamp
        points, covariances, variances, weights = own
        others, other_covariances, other_variances, other_weights = other
        windows, cut = within
        for i in prange(points.shape[0]):
            row = sums[i]
            row[:] = 0.0
            room = Room(np.empty((3, 3)), np.empty((3, 3)), np.empty(6), np.empty(6))
            p = points[i]
            for k in range(windows[0, i], windows[1, i]):
                x = others[k]
                dx, dy, dz = p[0] - x[0], p[1] - x[1], p[2] - x[2]
                if dot(dx, dy, dz, dx, dy, dz) > cut * (variances[i] + other_variances[k]):
                    continue
                weight = weights[i] * other_weights[k]
                likeness = 1.0
                if hues is not None:
                    h, o = hues.own[i], hues.other[k]
                    unlike = capped_distance(h[0], h[1], h[2], o[0], o[1], o[2], hues.cap)
                    likeness = math.exp(-unlike) / hues.expected
                likelihood = Likelihood(weight, likeness, shares[k])
                this, that = (p, covariances[i]), (x, other_covariances[k])
                if own_is_source:
                    add_pair(this, that, planar, cut, likelihood, True, room, row)
                else:
                    add_pair(that, this, planar, cut, likelihood, False, room, row)

    return score_sums


score_sums = _build(source_stamp())
