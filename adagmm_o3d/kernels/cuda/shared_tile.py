"""The points of a tile that a block has read into its shared memory: (TILE, components), as `layout` has them.

The loop over tiles stands in every kernel itself: Numba's simulator lets threads wait for their block only there.
"""

from adagmm_o3d.kernels.cuda.front_end import F0, fast, formulas
from adagmm_o3d.kernels.cuda.tiles import Packed, Point
from adagmm_o3d.kernels.layout import MATRIX, X

capped_distance = formulas.capped_distance


@fast
def point_at(x, j):
    """Where point j of the tile `x` lies."""
    return Point(x[j, X], x[j, X + 1], x[j, X + 2])


@fast
def packed_at(x, j):
    """Its packed matrix."""
    return Packed(
        x[j, MATRIX], x[j, MATRIX + 1], x[j, MATRIX + 2], x[j, MATRIX + 3], x[j, MATRIX + 4], x[j, MATRIX + 5]
    )


@fast
def offset(a, b):
    """a - b of two points."""
    return Point(a.x - b.x, a.y - b.y, a.z - b.z)


@fast
def combined(a, b):
    """A + B of two packed matrices."""
    return Packed(a.xx + b.xx, a.xy + b.xy, a.xz + b.xz, a.yy + b.yy, a.yz + b.yz, a.zz + b.zz)


def unlike_from(hue):
    """(x, j, own, cap) → the capped distance of colour `own` to that of point j of the tile `x`, which is at `hue`."""

    @fast
    def unlike_at(x, j, own, cap):
        return capped_distance(own.x, own.y, own.z, x[j, hue], x[j, hue + 1], x[j, hue + 2], cap)

    return unlike_at


@fast
def alike(x, j, own, cap):
    """The same where colours do not count."""
    return F0


@fast
def colour_of(hues, tile, t):
    """The colour of point t of a tile."""
    return Point(hues[tile, 0, t], hues[tile, 1, t], hues[tile, 2, t])


@fast
def no_colour_of(hues, tile, t):
    """The same where colours do not count."""
    return Point(F0, F0, F0)
