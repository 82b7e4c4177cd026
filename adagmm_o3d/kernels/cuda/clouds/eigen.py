"""Eigenvalues and eigenvectors of symmetric 3x3 matrices on the GPU, in float64, by Jacobi's rotations."""

import math

from adagmm_o3d.kernels.cuda.front_end import exact

# Each squares what is left off the diagonal; five are enough for float64 to see nothing there.
SWEEPS = 6


@exact
def rotation(pp, qq, pq):
    """cos, sin and tan of the turn that makes the off-diagonal entry pq vanish."""
    apart = qq - pp
    longer = apart + math.copysign(math.sqrt(apart * apart + 4.0 * pq * pq), apart)
    if longer == 0.0:
        return 1.0, 0.0, 0.0
    tangent = 2.0 * pq / longer
    cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
    return cosine, tangent * cosine, tangent


@exact
def turned(c, s, a, b):
    """The pair (a, b) turned."""
    return c * a - s * b, s * a + c * b


@exact
def eigen(a00, a01, a02, a11, a12, a22):
    """Ascending eigenvalues of a packed symmetric matrix, then the three unit eigenvectors in that order."""
    x0, x1, x2 = 1.0, 0.0, 0.0
    y0, y1, y2 = 0.0, 1.0, 0.0
    z0, z1, z2 = 0.0, 0.0, 1.0
    for _ in range(SWEEPS):
        c, s, t = rotation(a00, a11, a01)
        a00, a11, a01 = a00 - t * a01, a11 + t * a01, 0.0
        a02, a12 = turned(c, s, a02, a12)
        x0, y0 = turned(c, s, x0, y0)
        x1, y1 = turned(c, s, x1, y1)
        x2, y2 = turned(c, s, x2, y2)
        c, s, t = rotation(a00, a22, a02)
        a00, a22, a02 = a00 - t * a02, a22 + t * a02, 0.0
        a01, a12 = turned(c, s, a01, a12)
        x0, z0 = turned(c, s, x0, z0)
        x1, z1 = turned(c, s, x1, z1)
        x2, z2 = turned(c, s, x2, z2)
        c, s, t = rotation(a11, a22, a12)
        a11, a22, a12 = a11 - t * a12, a22 + t * a12, 0.0
        a01, a02 = turned(c, s, a01, a02)
        y0, z0 = turned(c, s, y0, z0)
        y1, z1 = turned(c, s, y1, z1)
        y2, z2 = turned(c, s, y2, z2)
    if a11 < a00:
        a00, x0, x1, x2, a11, y0, y1, y2 = a11, y0, y1, y2, a00, x0, x1, x2
    if a22 < a11:
        a11, y0, y1, y2, a22, z0, z1, z2 = a22, z0, z1, z2, a11, y0, y1, y2
    if a11 < a00:
        a00, x0, x1, x2, a11, y0, y1, y2 = a11, y0, y1, y2, a00, x0, x1, x2
    return a00, a11, a22, x0, x1, x2, y0, y1, y2, z0, z1, z2
