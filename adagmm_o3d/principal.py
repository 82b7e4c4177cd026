"""How points scatter: principal variances and axes of many small symmetric matrices, and scatter of neighbourhoods."""

import math

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array


def principal_axes(matrices: Array) -> tuple[Array, Array]:
    """(n, D) eigenvalues, ascending, and (n, D, D) eigenvectors, in columns, of (n, D, D) symmetric matrices; D = 2 or
    3."""
    if matrices.shape[1] == 2:
        variances, axes = np.linalg.eigh(matrices)
        return variances, axes
    # Compiled kernels come with Numba, which is imported with the first of them.
    from adagmm_o3d.kernels.cpu.principal import principal_axes

    variances, axes = np.empty(matrices.shape[:2]), np.empty(matrices.shape)
    principal_axes(np.ascontiguousarray(matrices, np.float64), variances, axes)
    return variances, axes


def principal_variances(matrices: Array) -> Array:
    """(n, D) eigenvalues, ascending, of (n, D, D) symmetric matrices; D = 2 or 3."""
    if matrices.shape[1] == 3:
        return principal_axes(matrices)[0]
    xx, xy, yy = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 1]
    mean, deviation = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.column_stack([mean - deviation, mean + deviation])


def scatter_among(
    points: Array,
    rows: NDArray[np.int64],
    *,
    weights: Array | None = None,
    squares: Array | None = None,
    reach_sq: float = math.inf,
) -> tuple[Array, NDArray[np.int64]]:
    """(n, D, D) covariances of neighbourhoods, and (n,) how many points are in each.

    points : (N, D).   rows : (n, k) which of them are a neighbourhood.   weights : (N,) of the points, or None for
    ones.   squares : (n, k) squared distances, of which those above `reach_sq` do not count, or None.
    """
    from adagmm_o3d.kernels.cpu.principal import scatter_among

    count, dimension = len(rows), points.shape[1]
    scatters, counts = np.empty((count, dimension, dimension)), np.empty(count, np.int64)
    scatter_among(
        np.ascontiguousarray(points, np.float64),
        np.ones(len(points)) if weights is None else weights,
        np.ascontiguousarray(rows),
        np.zeros(rows.shape) if squares is None else squares,
        reach_sq,
        scatters,
        counts,
    )
    return scatters, counts
