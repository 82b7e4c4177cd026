"""Normals of a surface, in the plane of a curve, from a cloud's own neighbours."""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.neighbors import NeighborIndex


def surface_normals(points: Array, dimension: int, neighbors: int) -> tuple[Array, Array]:
    """(n, 3) unit normals of the surface through each of (n, 3) points and so many neighbours, and (n,) the variance
    across it as a share of the larger one along it: 0 on a plane, towards 1 where there is no surface.
    """
    flat = np.ascontiguousarray(points[:, :dimension])
    around = flat[NeighborIndex(flat).query(flat, neighbors)[0]]
    variances, normals = normals_of(around, dimension)
    return normals, variances[:, 0] / np.maximum(variances[:, 1], 1e-300)


def normals_of(around: Array, dimension: int) -> tuple[Array, Array]:
    """(n, D) ascending sums of squares along the axes of the scatter of (n, k, D) points, and (n, 3) unit normals."""
    offsets = around - around.mean(axis=1, keepdims=True)
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    normals = np.zeros((len(around), 3))
    normals[:, :dimension] = axes[:, :, 0]
    return variances, normals
