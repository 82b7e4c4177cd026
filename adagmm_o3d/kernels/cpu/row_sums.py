"""What a run of pairs adds to the sums of a source point, `rows` (layout.ROW_SUMS, points), in float64."""

from numba import njit

from adagmm_o3d.kernels.cpu.compiling import FLAGS
from adagmm_o3d.kernels.layout import ENERGY, PRECISION, PULL, WEIGHT


@njit(**FLAGS)
def add_full(rows, k, weight, energy, p0, p1, p2, p3, p4, p5, u0, u1, u2):
    """To those of point k: weight, energy, packed precision and pull."""
    rows[WEIGHT, k] += weight
    rows[ENERGY, k] += energy
    rows[PRECISION, k] += p0
    rows[PRECISION + 1, k] += p1
    rows[PRECISION + 2, k] += p2
    rows[PRECISION + 3, k] += p3
    rows[PRECISION + 4, k] += p4
    rows[PRECISION + 5, k] += p5
    rows[PULL, k] += u0
    rows[PULL + 1, k] += u1
    rows[PULL + 2, k] += u2


@njit(**FLAGS)
def add_isotropic(rows, k, weight, energy, precision, u0, u1, u2):
    """The same where the precision is a multiple of the identity."""
    rows[WEIGHT, k] += weight
    rows[ENERGY, k] += energy
    rows[PRECISION, k] += precision
    rows[PRECISION + 3, k] += precision
    rows[PRECISION + 5, k] += precision
    rows[PULL, k] += u0
    rows[PULL + 1, k] += u1
    rows[PULL + 2, k] += u2
