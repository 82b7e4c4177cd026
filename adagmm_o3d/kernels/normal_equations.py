"""The sums of one source point turned into its share of the M-step's 6x6 system, in float64."""

from numba import njit

from .compiling import FLAGS, formulas
from .layout import ENERGY, GRADIENT, HESSIAN, PRECISION, PULL, TOTAL_ENERGY, TOTAL_WEIGHT, TURN, WEIGHT

normal_equations = formulas.normal_equations


@njit(**FLAGS)
def add_row(rows, k, amplitude, y0, y1, y2, turned, total):
    """Turn the sums of source point k into its share of the M-step's 6x6 system (layout.TOTAL_SUMS), float64."""
    w = amplitude * rows[k, WEIGHT]
    p0 = amplitude * rows[k, PRECISION] + w * turned[k, 0]
    p1 = amplitude * rows[k, PRECISION + 1] + w * turned[k, 1]
    p2 = amplitude * rows[k, PRECISION + 2] + w * turned[k, 2]
    p3 = amplitude * rows[k, PRECISION + 3] + w * turned[k, 3]
    p4 = amplitude * rows[k, PRECISION + 4] + w * turned[k, 4]
    p5 = amplitude * rows[k, PRECISION + 5] + w * turned[k, 5]
    u0 = amplitude * rows[k, PULL]
    u1 = amplitude * rows[k, PULL + 1]
    u2 = amplitude * rows[k, PULL + 2]
    # By name: Numba looks an entry of a tuple up by a number known only in a loop through a jump table.
    (
        h00, h01, h02, h03, h04, h05, h11, h12, h13, h14, h15, h22, h23, h24, h25, h33, h34, h35, h44, h45, h55,
        g0, g1, g2, g3, g4, g5,
    ) = normal_equations(
        y0, y1, y2, p0, p1, p2, p3, p4, p5, u0, u1, u2,
        amplitude * rows[k, TURN], amplitude * rows[k, TURN + 1], amplitude * rows[k, TURN + 2],
    )  # fmt: skip
    total[HESSIAN] += h00
    total[HESSIAN + 1] += h01
    total[HESSIAN + 2] += h02
    total[HESSIAN + 3] += h03
    total[HESSIAN + 4] += h04
    total[HESSIAN + 5] += h05
    total[HESSIAN + 6] += h11
    total[HESSIAN + 7] += h12
    total[HESSIAN + 8] += h13
    total[HESSIAN + 9] += h14
    total[HESSIAN + 10] += h15
    total[HESSIAN + 11] += h22
    total[HESSIAN + 12] += h23
    total[HESSIAN + 13] += h24
    total[HESSIAN + 14] += h25
    total[HESSIAN + 15] += h33
    total[HESSIAN + 16] += h34
    total[HESSIAN + 17] += h35
    total[HESSIAN + 18] += h44
    total[HESSIAN + 19] += h45
    total[HESSIAN + 20] += h55
    total[GRADIENT] += g0
    total[GRADIENT + 1] += g1
    total[GRADIENT + 2] += g2
    total[GRADIENT + 3] += g3
    total[GRADIENT + 4] += g4
    total[GRADIENT + 5] += g5
    total[TOTAL_WEIGHT] += w
    total[TOTAL_ENERGY] += amplitude * rows[k, ENERGY]
