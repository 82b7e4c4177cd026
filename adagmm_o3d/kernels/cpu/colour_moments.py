"""Moments of the colours of pairs, each by its weight: what the variance of colour differences is estimated from."""

import math

from numba import njit

from adagmm_o3d.kernels.cpu.compiling import FLAGS, SERIAL_KERNEL_FLAGS, formulas, source_stamp

dot, adjugate, symmetric_product = formulas.dot, formulas.adjugate, formulas.symmetric_product

# For a source point: the density of the target there, the part of it that tells the truth, and for each of the three
# coordinates of colour, weighed by that part, the sums of s, t, s s, t t and s t, of source and target.
DENSITY, TRUE, FIRST = 0, 1, 2
PER_COORDINATE = 5
MOMENTS = FIRST + 3 * PER_COORDINATE


@njit(**FLAGS)
def honesty(own, other, gain, offset, precision, ratio):
    """Probability that two colours of the same place are not one that lies: `ratio` is how much likelier no difference
    at all is to come from a place seen twice than from a colour that lies."""
    half = 0.0
    for k in range(3):
        difference = gain[k] * own[k] + offset[k] - other[k]
        half += 0.5 * precision[k] * difference * difference
    honest = ratio * math.exp(-half)
    return honest / (honest + 1.0), honest + 1.0


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def colour_moments(own, other, windows, planar, cut, model, moments):
        """Fill `moments` (K, MOMENTS) for K source points with all target points.

        own, other : points (n, 3), packed covariances (n, 6), largest variances (n,), colours (n, 3); the source's are
        moved and turned. `other` also has weights (n,), and is in the order of the coordinate of `windows` (2, K), the
        first of its points to look at and the one past the last.   cut : largest squared Mahalanobis distance.
        model : gain (3,), offset (3,), precision (3,), ratio, see `honesty`; ratio 0 takes every colour for true.
        """
        _ = stamp
        points, covariances, variances, colours = own
        others, other_covariances, other_variances, other_colours, weights = other
        gain, offset, precision, ratio = model
        for i in range(points.shape[0]):
            row = moments[i]
            row[:] = 0.0
            p, a = points[i], covariances[i]
            for n in range(windows[0, i], windows[1, i]):
                x, b = others[n], other_covariances[n]
                dx, dy, dz = p[0] - x[0], p[1] - x[1], p[2] - x[2]
                if dot(dx, dy, dz, dx, dy, dz) > cut * (variances[i] + other_variances[n]):
                    continue
                s0, s1, s2, s3, s4 = a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4]
                s5 = 1.0 if planar else a[5] + b[5]
                c0, c1, c2, c3, c4, c5 = adjugate(s0, s1, s2, s3, s4, s5)
                inverse = 1.0 / dot(s0, s1, s2, c0, c1, c2)
                vx, vy, vz = symmetric_product(c0, c1, c2, c3, c4, c5, dx, dy, dz)
                q = dot(dx, dy, dz, vx, vy, vz) * inverse
                if q > cut:
                    continue
                density = weights[n] * math.sqrt(inverse) * math.exp(-0.5 * q)
                honest, likelihood = 1.0, 1.0
                if ratio > 0.0:
                    honest, likelihood = honesty(colours[i], other_colours[n], gain, offset, precision, ratio)
                row[DENSITY] += density * likelihood
                true = density * likelihood * honest
                row[TRUE] += true
                for k in range(3):
                    s, t = colours[i, k], other_colours[n, k]
                    column = FIRST + PER_COORDINATE * k
                    row[column] += true * s
                    row[column + 1] += true * t
                    row[column + 2] += true * s * s
                    row[column + 3] += true * t * t
                    row[column + 4] += true * s * t

    return colour_moments


colour_moments = _build(source_stamp())
