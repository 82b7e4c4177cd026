"""Covariances from the surface itself: wide along it, thin across it, for clouds whose sensor is unknown."""

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, float_array, real_number, unit_vectors, whole_number
from adagmm_o3d.errors import DegenerateError, InputError
from adagmm_o3d.kernels.limits import EPSILON, KNN, LINE_RATIO
from adagmm_o3d.neighbors import NeighborIndex

CHUNK = 65536
"""Points whose neighbourhoods are gathered at a time; bounds the memory."""


def estimate_surface_covariances(
    points: ArrayLike, normals: ArrayLike | None = None, *, knn: int = KNN, epsilon: float = EPSILON
) -> Array:
    """Plane covariances as in Generalized ICP: 1 along the surface, `epsilon` across it; in 2D along a curve.

    Σ = I − (1 − epsilon) n nᵀ with n the normal. Where no normals are given, n is the direction in which the `knn`
    nearest points, the point itself among them, vary least. Where these lie on one line or coincide there is no such
    direction, and Σ = I.

    Parameters
    ----------
    points : (N, D), D = 2 or 3, any unit.
    normals : (N, D) or None; any non-zero length, either sign.
    knn : neighbours per point, at least D + 1; all points where there are fewer. Unused when normals are given.
    epsilon : variance across the surface, 0 < epsilon ≤ 1.

    Returns
    -------
    (N, D, D) float64, positive definite, relative (unitless).

    Raises
    ------
    InputTypeError, InputError  if an argument is no finite array of that shape, a normal has length 0, or a number is
                                out of range.
    DegenerateError             if normals have to be estimated from no more than D points.

    Source
    ------
    A. Segal, D. Haehnel, S. Thrun, Generalized-ICP, RSS 2009, Section III; the defaults are Open3D's.
    """
    p = float_array("points", points, ("N", (2, 3)))
    dimension = p.shape[1]
    neighbors = whole_number("knn", knn, minimum=dimension + 1)
    thickness = real_number("epsilon", epsilon, above=0.0)
    if thickness > 1.0:
        raise InputError(f"epsilon: expected at most 1, got {thickness:g}; it is the variance across the surface")
    if normals is None:
        n = _estimate_normals(p, neighbors)
    else:
        n = unit_vectors("normals", normals, ("N", dimension))
        if len(n) != len(p):
            raise InputError(f"normals: expected {p.shape} to match the points, got {n.shape}")
    return np.eye(dimension) - (1.0 - thickness) * (n[:, :, None] * n[:, None, :])


def check_count(count: int, dimension: int) -> None:
    """Raise if so few points have no normals."""
    if count <= dimension:
        raise DegenerateError(
            f"points: expected more than {dimension} to estimate normals from, got {count}; pass normals or covariances"
        )


def _estimate_normals(points: Array, knn: int) -> Array:
    """Unit normals (N, D), zero where the neighbourhood has none."""
    check_count(*points.shape)
    index = NeighborIndex(points)
    normals = np.empty_like(points)
    for start in range(0, len(points), CHUNK):
        chunk = slice(start, start + CHUNK)
        rows, _ = index.query(points[chunk], knn)
        offsets = points[rows] - points[rows].mean(axis=1, keepdims=True)
        scatter = np.einsum("nki,nkj->nij", offsets, offsets)
        variances, directions = np.linalg.eigh(scatter)
        has_normal = variances[:, 1] > LINE_RATIO * variances.sum(axis=1)
        normals[chunk] = np.where(has_normal[:, None], directions[:, :, 0], 0.0)
    return normals
