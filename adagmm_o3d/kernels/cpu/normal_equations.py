"""The sums of a cluster of source points turned into their share of the M-step's 6x6 system, in float64."""

import numpy as np
from numba import njit

from adagmm_o3d.kernels.cpu.compiling import FLAGS, formulas
from adagmm_o3d.kernels.layout import (
    ENERGY,
    GRADIENT,
    HESSIAN,
    PRECISION,
    PULL,
    TORQUE,
    TOTAL_ENERGY,
    TOTAL_WEIGHT,
    WEIGHT,
)

normal_equations = formulas.normal_equations


@njit(**FLAGS)
def add_rows(rows, count, amplitudes, y, total):
    """Turn the sums of `count` source points `y` (3, points) into their share of the M-step's system.

    rows : (layout.ROW_SUMS, points).   amplitudes : (points,), by which each point's sums are multiplied.
    total : (layout.TOTAL_SUMS,).
    """
    # Points side by side in vectors, each sum in a variable of its own.
    h00 = h01 = h02 = h03 = h04 = h05 = h11 = h12 = h13 = h14 = h15 = 0.0
    h22 = h23 = h24 = h25 = h33 = h34 = h35 = h44 = h45 = h55 = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = weight = energy = 0.0
    for k in range(count):
        amplitude = amplitudes[k]
        # By name: Numba looks an entry of a tuple up by a number known only in a loop through a jump table.
        (
            a00, a01, a02, a03, a04, a05, a11, a12, a13, a14, a15,
            a22, a23, a24, a25, a33, a34, a35, a44, a45, a55,
            b0, b1, b2, b3, b4, b5,
        ) = normal_equations(
            np.float64(y[0, k]), np.float64(y[1, k]), np.float64(y[2, k]),
            amplitude * rows[PRECISION, k], amplitude * rows[PRECISION + 1, k], amplitude * rows[PRECISION + 2, k],
            amplitude * rows[PRECISION + 3, k], amplitude * rows[PRECISION + 4, k], amplitude * rows[PRECISION + 5, k],
            amplitude * rows[PULL, k], amplitude * rows[PULL + 1, k], amplitude * rows[PULL + 2, k],
            amplitude * rows[TORQUE, k], amplitude * rows[TORQUE + 1, k], amplitude * rows[TORQUE + 2, k],
        )  # fmt: skip
        h00 += a00
        h01 += a01
        h02 += a02
        h03 += a03
        h04 += a04
        h05 += a05
        h11 += a11
        h12 += a12
        h13 += a13
        h14 += a14
        h15 += a15
        h22 += a22
        h23 += a23
        h24 += a24
        h25 += a25
        h33 += a33
        h34 += a34
        h35 += a35
        h44 += a44
        h45 += a45
        h55 += a55
        g0 += b0
        g1 += b1
        g2 += b2
        g3 += b3
        g4 += b4
        g5 += b5
        weight += amplitude * rows[WEIGHT, k]
        energy += amplitude * rows[ENERGY, k]
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
    total[TOTAL_WEIGHT] += weight
    total[TOTAL_ENERGY] += energy
