"""The sums of one source point turned into its share of the M-step's 6x6 system, in float64."""

from numba import njit

from .compiling import FLAGS, formulas
from .layout import ENERGY, PRECISION, PULL, TOTAL_ENERGY, TOTAL_WEIGHT, TURN, WEIGHT

normal_equations = formulas.normal_equations


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
    terms = normal_equations(
        y0, y1, y2, p0, p1, p2, p3, p4, p5, u0, u1, u2,
        amplitude * row[TURN], amplitude * row[TURN + 1], amplitude * row[TURN + 2],
    )  # fmt: skip
    for i in range(TOTAL_WEIGHT):
        total[i] += terms[i]
    total[TOTAL_WEIGHT] += w
    total[TOTAL_ENERGY] += amplitude * row[ENERGY]
