"""Normals of a surface, in the plane of a curve, from a cloud's own neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.principal import principal_axes, scatter_among


def normals_of(points: Array, rows: NDArray[np.int64]) -> tuple[Array, Array]:
    """(n, D) ascending variances of (N, D) points along the axes of the neighbourhoods that (n, k) `rows` names, and
    (n, 3) unit normals."""
    dimension = points.shape[1]
    variances, axes = principal_axes(scatter_among(points, rows)[0])
    normals = np.zeros((len(rows), 3))
    normals[:, :dimension] = axes[:, :, 0]
    return variances, normals
