"""Which motions the shape of the matched points leaves free: the slide along a plane, the turn of a cylinder.

Points that are sampled from a surface say nothing about motion along it: what holds them there is only how the samples
happen to fall, and where the view ends. So each matched point is taken as a piece of surface that holds the pose along
its normal alone (the point-to-plane Hessian). A direction in which next to nothing is held is free.

Source
------
N. Gelfand, L. Ikemoto, S. Rusinkiewicz, M. Levoy: Geometrically Stable Sampling for the ICP Algorithm, 3DIM 2003.
"""

from __future__ import annotations

import sys

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.sampling import some_of
from adagmm_o3d.neighbors import NeighborIndex

# Clouds are thinned to this many points, so that neighbours are further apart than the noise.
THINNED = {2: 300, 3: 1000}
NEIGHBORS = 20
# A direction is free when the surfaces hold less than this share of what they would if every point were held in every
# direction. Measured: planes, spheres, cylinders, tubes, circles of 300 to 3000 points, noise up to 0.03 radii, below
# 0.015; cubes, polygons and irregular bodies above 0.04.
FREE_SHARE = 0.02
# Of clean surfaces less than that is real: what noise of the normals feigns is so many times its variance, and at least
# this.
NOISE_SHARES, LEAST_FREE_SHARE = 3.0, 0.003
# Of nothing, a matrix by which another is divided has this share of its trace: far below what float64 sums can mean.
NOTHING = 1e-12


def free_directions(source: Mixture, pose: Array, matched: Array) -> tuple[Array, ...]:
    """The motions of the source at `pose` that its matched surface leaves free.

    Parameters
    ----------
    source : normalised mixture.   pose : (4, 4) between normalised clouds.   matched : (M,) the probability of each
    source point to have a partner.

    Returns
    -------
    Orthonormal tangent directions (6,), in 2D (3,), in the order (ω, v). Lengths are in radii, so that a turn by one
    radian counts as a shift by one radius; turns are about the target's centroid.
    """
    dimension = source.dimension
    index = some_of(np.flatnonzero((source.variances <= FLAGGED) & np.isfinite(matched)), THINNED[dimension])
    points = source.points_at(index) @ pose[:3, :3].T + pose[:3, 3]
    weights = matched[index]
    normals, spread_sq = _normals(points, dimension)
    along_normals = np.concatenate([np.cross(points, normals), normals], axis=1)
    held = np.einsum("n,nk,nl->kl", weights, along_normals, along_normals)
    everywhere = np.zeros((6, 6))
    for axis in np.eye(3)[:dimension]:
        along_axis = np.concatenate([np.cross(points, axis), np.broadcast_to(axis, points.shape)], axis=1)
        everywhere += np.einsum("n,nk,nl->kl", weights, along_axis, along_axis)
    free = np.ix_(FREE[dimension], FREE[dimension])
    shares, motions = generalised_eigen(held[free], everywhere[free])
    noise = float((weights * spread_sq).sum() / max(weights.sum(), 1e-12))
    free_share = min(max(NOISE_SHARES * noise, LEAST_FREE_SHARE), FREE_SHARE)
    directions, _ = np.linalg.qr(motions[:, shares < free_share])
    return tuple(directions.T)


def _normals(points: Array, dimension: int) -> tuple[Array, Array]:
    """(n, 3) unit normals of the surface (in 2D the curve) through each point and its neighbours, and (n,) how far off
    they are [rad²], by the scatter across the surface beside that along it."""
    flat = np.ascontiguousarray(points[:, :dimension])
    neighbors = flat[NeighborIndex(flat).query(flat, NEIGHBORS)[0]]
    offsets = neighbors - neighbors.mean(axis=1, keepdims=True)
    normals = np.zeros((len(points), 3))
    variances, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    normals[:, :dimension] = axes[:, :, 0]
    return normals, variances[:, 0] / (np.maximum(variances[:, 1], 1e-300) * neighbors.shape[1])


def generalised_eigen(a: Array, b: Array) -> tuple[Array, Array]:
    """Ascending λ and the columns x of a x = λ b x; b positive semidefinite.

    Where b says nothing (no point pulls across a flat outline that is registered to itself), a trace of it stands in,
    and λ is large or, where a says nothing either, zero.
    """
    least = max(NOTHING * float(np.trace(b)), sys.float_info.min)
    inverse = np.linalg.inv(np.linalg.cholesky(b + least * np.eye(len(b))))
    values, vectors = np.linalg.eigh(inverse @ a @ inverse.T)
    return values, inverse.T @ vectors
