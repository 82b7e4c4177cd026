"""Normals of a surface, in the plane of a curve, from a cloud's own neighbours; and how many face alike."""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array

# How sharply normals are told apart: two this far apart count e times less for one direction.
CONCENTRATION = 1.0 / math.sin(math.radians(7.5)) ** 2


def normals_of(around: Array, dimension: int) -> tuple[Array, Array]:
    """(n, D) ascending sums of squares along the axes of the scatter of (n, k, D) points, and (n, 3) unit normals."""
    offsets = around - around.mean(axis=1, keepdims=True)
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    normals = np.zeros((len(around), 3))
    normals[:, :dimension] = axes[:, :, 0]
    return variances, normals


def facing(normals: Array) -> Array:
    """(n,) how many of (n, 3) unit normals face where each does, of either sign."""
    return alike(normals @ normals.T).sum(axis=1)


def alike(cosines: Array) -> Array:
    """How much two normals at such angles count for one direction."""
    return np.exp(CONCENTRATION * (cosines**2 - 1.0))
