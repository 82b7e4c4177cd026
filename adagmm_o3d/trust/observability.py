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
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.sampling import some_of
from adagmm_o3d.trust.normals import normals_of

# Clouds are thinned to this many points, so that neighbours are further apart than the noise.
THINNED = {2: 300, 3: 1000}
NEIGHBORS = 20
# A direction is free when the surfaces hold less than this share of what they would if every point were held in every
# direction: the edges of a corridor feign so much along it. A room of which the ends are in view holds its pose by a
# hundredth, and well enough. Of what two normals of one point differ by, a part is feigned as well; cubes, polygons and
# irregular bodies are held by more than the largest share.
FREE_SHARE, NOISE_SHARE, LARGEST_FREE_SHARE = 0.004, {2: 0.5, 3: 0.2}, {2: 0.03, 3: 0.02}
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
    normals = _two_normals(points, dimension)
    first, second = (_along(points, of) for of in normals)
    # Their noise is independent, so that what it feigns to hold averages to nothing.
    held = np.einsum("n,nk,nl->kl", weights, first, second)
    held = 0.5 * (held + held.T)
    everywhere = np.zeros((6, 6))
    for axis in np.eye(3)[:dimension]:
        along_axis = _along(points, np.broadcast_to(axis, points.shape))
        everywhere += np.einsum("n,nk,nl->kl", weights, along_axis, along_axis)
    free = np.ix_(FREE[dimension], FREE[dimension])
    shares, motions = generalised_eigen(held[free], everywhere[free])
    noise = float(np.median(1.0 - np.minimum((normals[0] * normals[1]).sum(axis=1) ** 2, 1.0)))
    free_share = min(max(NOISE_SHARE[dimension] * noise, FREE_SHARE), LARGEST_FREE_SHARE[dimension])
    directions, _ = np.linalg.qr(motions[:, shares < free_share])
    return tuple(directions.T)


def _two_normals(points: Array, dimension: int) -> tuple[Array, Array]:
    """(n, 3) unit normals of the surface (in 2D the curve) at each point, twice, from neighbours of which none is in
    both; the second has the first's sign."""
    flat = np.ascontiguousarray(points[:, :dimension])
    near = NeighborIndex(flat).query(flat, NEIGHBORS + 1)[0][:, 1:]
    first, second = (normals_of(flat, near[:, part::2])[1] for part in (0, 1))
    return first, second * np.where((first * second).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]


def _along(points: Array, axes: Array) -> Array:
    """(n, 6) how far a unit of each motion takes (n, 3) points along (n, 3) axes."""
    return np.concatenate([np.cross(points, axes), axes], axis=1)


def generalised_eigen(a: Array, b: Array) -> tuple[Array, Array]:
    """Ascending λ and the columns x of a x = λ b x; b positive semidefinite.

    Where b says nothing (no point pulls across a flat outline that is registered to itself), a trace of it stands in,
    and λ is large or, where a says nothing either, zero.
    """
    least = max(NOTHING * float(np.trace(b)), sys.float_info.min)
    inverse = np.linalg.inv(np.linalg.cholesky(b + least * np.eye(len(b))))
    values, vectors = np.linalg.eigh(inverse @ a @ inverse.T)
    return values, inverse.T @ vectors
