"""A cloud read where it lies on the device: every point and covariance checked, as `mixture.make_mixture` does.

What is known of the points is one table, (POINT_ROWS, n) float64: a row for each coordinate, each entry of the packed
covariance, the geometric mean of the principal variances, and the largest of them.
"""

import math

from numba import float64

from adagmm_o3d.kernels.cuda.clouds.eigen import eigen
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda, exact, kernel, source_stamp
from adagmm_o3d.kernels.limits import EPSILON, ROUNDING, SMALLEST, THINNEST

COVARIANCE, VARIANCE, LARGEST = 3, 9, 10
POINT_ROWS = 11
# What may be wrong with a point, of which the first counts, and the bits that hold it. What else is found is added: a
# covariance that is no multiple of the identity, is singular, or is zero.
FINE, POINT_NOT_FINITE, COVARIANCE_NOT_FINITE, CROOKED, NOT_POSITIVE = range(5)
FAULTS, ANISOTROPIC, SINGULAR, EMPTY = 7, 8, 16, 32


@exact
def along(values, a, b):
    """One entry of the matrix with eigenvalues `values` (3): a and b (3), the eigenvectors' components of two axes."""
    return values[0] * a[0] * b[0] + values[1] * a[1] * b[1] + values[2] * a[2] * b[2]


def _build(given, stamp):
    """The kernel for clouds with covariances (`given`), or without: then the identity stands for each."""

    @kernel
    def inspect(positions, covariances, points, status):
        """One thread for each point. positions (n, 3), covariances (n, 3, 3), float32 or float64.

        points : (POINT_ROWS, n) float64, status : (n,) uint8; both overwritten.
        """
        _ = stamp
        i = cuda.blockIdx.x * TILE + cuda.threadIdx.x
        if i >= positions.shape[0]:
            return
        x, y, z = float64(positions[i, 0]), float64(positions[i, 1]), float64(positions[i, 2])
        points[0, i] = x
        points[1, i] = y
        points[2, i] = z
        found = FINE
        c00 = c11 = c22 = variance = largest = 1.0
        c01 = c02 = c12 = 0.0
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            found = POINT_NOT_FINITE
        elif given:
            size = 0.0
            for k in range(3):
                for j in range(3):
                    entry = float64(covariances[i, k, j])
                    if not math.isfinite(entry):
                        found = COVARIANCE_NOT_FINITE
                    size = max(size, abs(entry))
            if found == FINE:
                skew = 0.0
                for k in range(3):
                    for j in range(k):
                        skew = max(skew, abs(float64(covariances[i, k, j]) - float64(covariances[i, j, k])))
                if skew > ROUNDING * size:
                    found = CROOKED
                elif size < SMALLEST:
                    found = EMPTY
                    c00 = c11 = c22 = variance = largest = 0.0
            if found == FINE:
                c00, c11, c22 = (
                    float64(covariances[i, 0, 0]),
                    float64(covariances[i, 1, 1]),
                    float64(covariances[i, 2, 2]),
                )
                c01 = 0.5 * float64(covariances[i, 0, 1]) + 0.5 * float64(covariances[i, 1, 0])
                c02 = 0.5 * float64(covariances[i, 0, 2]) + 0.5 * float64(covariances[i, 2, 0])
                c12 = 0.5 * float64(covariances[i, 1, 2]) + 0.5 * float64(covariances[i, 2, 1])
                isotropic = c01 == 0.0 and c02 == 0.0 and c12 == 0.0 and c00 == c11 and c00 == c22
                l0, l1, l2, x0, x1, x2, y0, y1, y2, z0, z1, z2 = eigen(
                    c00 / size, c01 / size, c02 / size, c11 / size, c12 / size, c22 / size
                )
                if l0 < -ROUNDING * max(l2, -l0):
                    found = NOT_POSITIVE
                elif l0 < THINNEST * l2:
                    found = SINGULAR
                    l0, l1 = size * EPSILON * l2, size * max(l1, EPSILON * l2)
                    l2 = size * l2
                    values, of_x, of_y, of_z = (l0, l1, l2), (x0, y0, z0), (x1, y1, z1), (x2, y2, z2)
                    c00, c01, c02 = along(values, of_x, of_x), along(values, of_x, of_y), along(values, of_x, of_z)
                    c11, c12, c22 = along(values, of_y, of_y), along(values, of_y, of_z), along(values, of_z, of_z)
                    variance, largest = (l0 / l2 * (l1 / l2)) ** (1.0 / 3.0) * l2, l2
                elif isotropic:
                    variance = largest = c00
                else:
                    variance, largest = size * (l0 * l1 * l2) ** (1.0 / 3.0), size * l2
                if not isotropic:
                    found += ANISOTROPIC
        status[i] = found
        points[COVARIANCE, i] = c00
        points[COVARIANCE + 1, i] = c01
        points[COVARIANCE + 2, i] = c02
        points[COVARIANCE + 3, i] = c11
        points[COVARIANCE + 4, i] = c12
        points[COVARIANCE + 5, i] = c22
        points[VARIANCE, i] = variance
        points[LARGEST, i] = largest

    return inspect


def _build_fill(stamp):
    @kernel
    def fill_empty(points, variance):
        """One thread for each point of a table: covariances that are zero become `variance` times the identity."""
        _ = stamp
        i = cuda.blockIdx.x * TILE + cuda.threadIdx.x
        if i < points.shape[1] and points[LARGEST, i] == 0.0:
            points[COVARIANCE, i] = variance
            points[COVARIANCE + 3, i] = variance
            points[COVARIANCE + 5, i] = variance
            points[VARIANCE, i] = variance
            points[LARGEST, i] = variance

    return fill_empty


inspect_given = _build(True, source_stamp())
inspect_bare = _build(False, source_stamp())
fill_empty = _build_fill(source_stamp())
