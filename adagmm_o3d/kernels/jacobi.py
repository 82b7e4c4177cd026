"""Jacobi's rotations of a symmetric 3 x 3 matrix, written once and compiled for every device.

`build` compiles them with the decorator of one device, see `formulas`. How often they are repeated, each device says.
"""

import math
from types import SimpleNamespace


def build(jit):
    """`sweep` and `ascending`, compiled by `jit`, as a namespace."""

    @jit
    def rotation(pp, qq, pq):
        """cos, sin and tan of the turn that makes the off-diagonal entry pq vanish."""
        apart = qq - pp
        longer = apart + math.copysign(math.sqrt(apart * apart + 4.0 * pq * pq), apart)
        if longer == 0.0:
            return 1.0, 0.0, 0.0
        tangent = 2.0 * pq / longer
        cosine = 1.0 / math.sqrt(tangent * tangent + 1.0)
        return cosine, tangent * cosine, tangent

    @jit
    def turned(c, s, a, b):
        """The pair (a, b) turned."""
        return c * a - s * b, s * a + c * b

    @jit
    def sweep(xx, xy, xz, yy, yz, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2):
        """The packed matrix with each of its off-diagonal entries made to vanish once, and the axes x, y, z turned
        along. Each sweep squares what is left off the diagonal."""
        c, s, t = rotation(xx, yy, xy)
        xx, yy, xy = xx - t * xy, yy + t * xy, 0.0
        xz, yz = turned(c, s, xz, yz)
        x0, y0 = turned(c, s, x0, y0)
        x1, y1 = turned(c, s, x1, y1)
        x2, y2 = turned(c, s, x2, y2)
        c, s, t = rotation(xx, zz, xz)
        xx, zz, xz = xx - t * xz, zz + t * xz, 0.0
        xy, yz = turned(c, s, xy, yz)
        x0, z0 = turned(c, s, x0, z0)
        x1, z1 = turned(c, s, x1, z1)
        x2, z2 = turned(c, s, x2, z2)
        c, s, t = rotation(yy, zz, yz)
        yy, zz, yz = yy - t * yz, zz + t * yz, 0.0
        xy, xz = turned(c, s, xy, xz)
        y0, z0 = turned(c, s, y0, z0)
        y1, z1 = turned(c, s, y1, z1)
        y2, z2 = turned(c, s, y2, z2)
        return xx, xy, xz, yy, yz, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2

    @jit
    def ascending(xx, yy, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2):
        """The eigenvalues in ascending order, then the axes in that order."""
        if yy < xx:
            xx, x0, x1, x2, yy, y0, y1, y2 = yy, y0, y1, y2, xx, x0, x1, x2
        if zz < yy:
            yy, y0, y1, y2, zz, z0, z1, z2 = zz, z0, z1, z2, yy, y0, y1, y2
        if yy < xx:
            xx, x0, x1, x2, yy, y0, y1, y2 = yy, y0, y1, y2, xx, x0, x1, x2
        return xx, yy, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2

    return SimpleNamespace(sweep=sweep, ascending=ascending)
