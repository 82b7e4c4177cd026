"""The source's matrices turn with the source."""

from numba import njit

from .compiling import F0, FLAGS, formulas

rotate_symmetric = formulas.rotate_symmetric


@njit(**FLAGS)
def turn_symmetric(pose, matrices, scale, isotropic, m, turned):
    """R S Rᵀ of matrix m times `scale`, packed, into `turned`."""
    if isotropic:
        turned[:] = F0
        turned[0] = matrices[0, m] * scale
        turned[3] = turned[0]
        turned[5] = turned[0]
    else:
        turned[0], turned[1], turned[2], turned[3], turned[4], turned[5] = rotate_symmetric(
            pose,
            matrices[0, m] * scale,
            matrices[1, m] * scale,
            matrices[2, m] * scale,
            matrices[3, m] * scale,
            matrices[4, m] * scale,
            matrices[5, m] * scale,
        )
