"""The sums of one source point turned into its share of the M-step's 6x6 system, in float64."""

from numba import njit

from .compiling import FLAGS, formulas
from .layout import ENERGY, GRADIENT, HESSIAN, PRECISION, PULL, TOTAL_ENERGY, TOTAL_WEIGHT, TURN, WEIGHT

cross = formulas.cross


@njit(**FLAGS)
def add_row(row, amplitude, y0, y1, y2, b, total):
    """Turn the sums of one source point into its share of the M-step's 6x6 system (layout.TOTAL_SUMS), float64."""
    w = amplitude * row[WEIGHT]
    p0 = amplitude * row[PRECISION] + w * b[0]
    p1 = amplitude * row[PRECISION + 1] + w * b[1]
    p2 = amplitude * row[PRECISION + 2] + w * b[2]
    p3 = amplitude * row[PRECISION + 3] + w * b[3]
    p4 = amplitude * row[PRECISION + 4] + w * b[4]
    p5 = amplitude * row[PRECISION + 5] + w * b[5]
    u0 = amplitude * row[PULL]
    u1 = amplitude * row[PULL + 1]
    u2 = amplitude * row[PULL + 2]
    # [y]x P, row by row; the columns of P are (p0 p1 p2), (p1 p3 p4), (p2 p4 p5).
    k00, k10, k20 = cross(y0, y1, y2, p0, p1, p2)
    k01, k11, k21 = cross(y0, y1, y2, p1, p3, p4)
    k02, k12, k22 = cross(y0, y1, y2, p2, p4, p5)
    h = HESSIAN
    total[h] += k02 * y1 - k01 * y2
    total[h + 1] += k00 * y2 - k02 * y0
    total[h + 2] += k01 * y0 - k00 * y1
    total[h + 3] += k00
    total[h + 4] += k01
    total[h + 5] += k02
    total[h + 6] += k10 * y2 - k12 * y0
    total[h + 7] += k11 * y0 - k10 * y1
    total[h + 8] += k10
    total[h + 9] += k11
    total[h + 10] += k12
    total[h + 11] += k21 * y0 - k20 * y1
    total[h + 12] += k20
    total[h + 13] += k21
    total[h + 14] += k22
    total[h + 15] += p0
    total[h + 16] += p1
    total[h + 17] += p2
    total[h + 18] += p3
    total[h + 19] += p4
    total[h + 20] += p5
    g0, g1, g2 = cross(y0, y1, y2, u0, u1, u2)
    g = GRADIENT
    total[g] += g0 - amplitude * row[TURN]
    total[g + 1] += g1 - amplitude * row[TURN + 1]
    total[g + 2] += g2 - amplitude * row[TURN + 2]
    total[g + 3] += u0
    total[g + 4] += u1
    total[g + 5] += u2
    total[TOTAL_WEIGHT] += w
    total[TOTAL_ENERGY] += amplitude * row[ENERGY]
