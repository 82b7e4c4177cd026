"""The source's matrices turn with the source."""

from numba import njit

from adagmm_o3d.kernels.cpu.compiling import F0, POINTWISE_FLAGS, pointwise_formulas

rotate_symmetric = pointwise_formulas.rotate_symmetric


@njit(**POINTWISE_FLAGS)
def move_symmetric(pose, matrices, scale, isotropic, m, turned, k):
    """R S Rᵀ of matrix m times `scale`, packed, into row k of `turned`."""
    if isotropic:
        value = matrices[0, m] * scale
        turned[k, 0], turned[k, 1], turned[k, 2] = value, F0, F0
        turned[k, 3], turned[k, 4], turned[k, 5] = value, F0, value
    else:
        (
            turned[k, 0],
            turned[k, 1],
            turned[k, 2],
            turned[k, 3],
            turned[k, 4],
            turned[k, 5],
        ) = rotate_symmetric(
            pose,
            matrices[0, m] * scale,
            matrices[1, m] * scale,
            matrices[2, m] * scale,
            matrices[3, m] * scale,
            matrices[4, m] * scale,
            matrices[5, m] * scale,
        )
