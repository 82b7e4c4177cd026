"""Normals of a surface, in the plane of a curve, from a cloud's own neighbours."""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array


def normals_of(around: Array, dimension: int) -> tuple[Array, Array]:
    """(n, D) ascending sums of squares along the axes of the scatter of (n, k, D) points, and (n, 3) unit normals."""
    offsets = around - around.mean(axis=1, keepdims=True)
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    normals = np.zeros((len(around), 3))
    normals[:, :dimension] = axes[:, :, 0]
    return variances, normals
