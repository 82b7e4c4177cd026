"""Eigenvalues and eigenvectors of symmetric 3x3 matrices on the GPU, in float64, by Jacobi's rotations."""

from adagmm_o3d.kernels.cuda.front_end import exact
from adagmm_o3d.kernels.jacobi import build

# Five are enough for float64 to see nothing off the diagonal.
SWEEPS = 6

_jacobi = build(exact)
sweep, ascending = _jacobi.sweep, _jacobi.ascending


@exact
def eigen(xx, xy, xz, yy, yz, zz):
    """Ascending eigenvalues of a packed symmetric matrix, then the three unit eigenvectors in that order."""
    x0, x1, x2 = 1.0, 0.0, 0.0
    y0, y1, y2 = 0.0, 1.0, 0.0
    z0, z1, z2 = 0.0, 0.0, 1.0
    for _ in range(SWEEPS):
        xx, xy, xz, yy, yz, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2 = sweep(
            xx, xy, xz, yy, yz, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2
        )
    return ascending(xx, yy, zz, x0, x1, x2, y0, y1, y2, z0, z1, z2)
