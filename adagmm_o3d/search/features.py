"""Poses proposed by local features: where both clouds look alike, wherever they start and however little they share.

Both clouds are thinned evenly, each point gets a feature of its neighbourhood, points whose features are nearest to
each other become correspondences, and sets of these that keep their mutual distances become poses. Most correspondences
are wrong; sets of wrong ones rarely keep their distances.
"""

from __future__ import annotations

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.grouping import Groups, cell_numbers
from adagmm_o3d.kernels.cpu.consistency import shared_support
from adagmm_o3d.kernels.cpu.features import BINS, FEATURE, describe, nearest_features, scatter_around
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.principal import principal_axes
from adagmm_o3d.sampling import some_of

# Points of a thinned cloud, from how many of the cloud's, and how many of these each stands for at least: the normal of
# fewer is noise. With fewer thinned points than FEWEST no shape is left to recognise.
THINNED, THINNED_FROM, POINTS_EACH, FEWEST = 1000, 20_000, 1.1, 40
# Radii, in edges of the grid: of the neighbours that make a normal, which are no fewer than so many, and of those that
# make a feature.
NORMAL_RADIUS, NORMAL_POINTS, FEATURE_RADIUS = 1.5, 10, 5.0
# The correspondences that features agree on best.
CORRESPONDENCES = 600
# Two correspondences are compatible when their distances agree to so many edges and the cosines of their normals to
# this.
TOLERANCE, TURN = 1.25, 0.35
# So many correspondences, each with the others that it shares most support with, are made into poses.
SEEDS, CONSENSUS = 60, 20
# Fits of a pose to all correspondences that agree with it.
FITS = 2


class Thinned(NamedTuple):
    """A cloud on an even grid: points (k, 3), unit normals (k, 3) of either sign, features (k, FEATURE)."""

    points: Array
    normals: Array
    features: NDArray[np.float32]


class Alike(NamedTuple):
    """Two clouds on grids of one edge."""

    source: Thinned
    target: Thinned
    edge: float

    @property
    def too_few(self) -> bool:
        return min(len(self.source.points), len(self.target.points)) < FEWEST


def feature_poses(alike: Alike) -> list[Array]:
    """Poses (4, 4) between two normalised clouds in space, most supported first; none where no shape is recognised."""
    moving, fixed, edge = alike
    if alike.too_few:
        return []
    i, j = _correspondences(moving.features, fixed.features)
    p, q = moving.points[i], fixed.points[j]
    support = np.empty((len(p), len(p)), np.int32)
    shared_support(p, q, moving.normals[i], fixed.normals[j], TOLERANCE * edge, TURN, support)
    return _poses(p, q, support, TOLERANCE * edge)


def thinned_alike(source: Mixture, target: Mixture) -> Alike:
    """Both of two normalised mixtures in space on grids of one edge."""
    edges = [mixture.kept_for("grid edge", partial(_grid_edge, mixture)) for mixture in (source, target)]
    edge = max(edges)
    moving, fixed = (
        # On its own grid a cloud looks the same to every other one.
        mixture.kept_for("thinned", partial(_thinned, mixture, edge)) if own == edge else _thinned(mixture, edge)
        for mixture, own in zip((source, target), edges, strict=True)
    )
    return Alike(moving, fixed, edge)


def _some_points(mixture: Mixture) -> Array:
    """(n, 3) at most THINNED_FROM points that are not flagged as outliers."""
    return mixture.points_at(some_of(np.flatnonzero(mixture.variances <= FLAGGED), THINNED_FROM))


def _grid_edge(mixture: Mixture) -> float:
    """Edge of the cubes of which the points occupy about THINNED, or as many as hold POINTS_EACH on average."""
    points = _some_points(mixture)
    wanted = min(THINNED, len(points) / POINTS_EACH)
    edge = float(np.ptp(points, axis=0).max()) / 30.0 if len(points) else 1.0
    for _ in range(8):
        occupied = len(np.unique(_cells(points, edge)))
        if abs(occupied / wanted - 1.0) < 0.05:
            break
        edge *= (occupied / wanted) ** 0.5
    return edge


def _cells(points: Array, edge: float) -> NDArray[np.int64]:
    """(n,) a number for the cube of each point, counted from the corner of the cloud."""
    return cell_numbers(points - points.min(axis=0, initial=math.inf), np.full(len(points), edge))


def _thinned(mixture: Mixture, edge: float) -> Thinned:
    points = _in_order(_some_points(mixture))
    groups = Groups(_cells(points, edge), np.ones(len(points)))
    means = _in_order(groups.means(points))
    scatter = np.empty((len(means), 3, 3))
    reach = max(NORMAL_RADIUS, math.sqrt(NORMAL_POINTS * len(means) / (math.pi * len(points))))
    scatter_around(points, means, reach * edge, scatter)
    normals = np.ascontiguousarray(principal_axes(scatter)[1][:, :, 0])
    features = np.empty((len(means), FEATURE))
    describe(means, normals, FEATURE_RADIUS * edge, features)
    return Thinned(means, normals, features.astype(np.float32))


def _in_order(points: Array) -> Array:
    """(n, 3) points in ascending x."""
    return np.ascontiguousarray(points[np.argsort(points[:, 0], kind="stable")])


def _correspondences(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the pairs that are nearest to each other, mutual ones first and then by how far the second best is."""
    turned = b.copy()
    turned[:, :BINS], turned[:, 2 * BINS :] = b[:, BINS - 1 :: -1], b[:, : 2 * BINS - 1 : -1]
    there, back = np.empty(len(a), np.intp), np.empty(len(b), np.intp)
    least_there, least_back = np.empty((len(a), 2), np.float32), np.empty((len(b), 2), np.float32)
    tables = np.ascontiguousarray(b.T), np.ascontiguousarray(turned.T)
    nearest_features(a, *tables, there, least_there, back, least_back)
    i = np.concatenate([np.arange(len(a)), back])
    j = np.concatenate([there, np.arange(len(b))])
    ratio = np.concatenate([least[:, 0] / np.maximum(least[:, 1], 1e-12) for least in (least_there, least_back)])
    key, first, count = np.unique(i * len(b) + j, return_index=True, return_counts=True)
    order = np.lexsort((ratio[first], -count))[:CORRESPONDENCES]
    return np.divmod(key[order], len(b))


def _poses(p: Array, q: Array, support: NDArray[np.int32], tolerance: float) -> list[Array]:
    """The poses of the sets of correspondences p -> q that support each other, most supported first."""
    sets = _consensus_sets(support)
    if not sets:
        return []
    weights = np.zeros((len(sets), len(p)))
    for row, members in zip(weights, sets, strict=True):
        row[members] = support[members[0], members]
        row[members[0]] = row.max() + 1.0
    poses = _fitted(p, q, weights)
    agree = _agree(poses, p, q, tolerance)
    for _ in range(FITS):
        enough = agree.sum(axis=1) >= 3
        poses[enough] = _fitted(p, q, agree[enough].astype(np.float64))
        agree[enough] = _agree(poses[enough], p, q, tolerance)
    return list(poses[np.argsort(-agree.sum(axis=1), kind="stable")])


def _consensus_sets(support: NDArray[np.int32]) -> list[NDArray[np.intp]]:
    """For up to SEEDS correspondences, most supported first, each with the others that it shares most support with; a
    seed is in no set before its own."""
    free = np.full(len(support), True)
    sets: list[NDArray[np.intp]] = []
    for seed in np.argsort(-support.sum(axis=1), kind="stable"):
        if len(sets) == SEEDS:
            break
        if not free[seed]:
            continue
        row = support[seed]
        members = np.argsort(-row, kind="stable")[: CONSENSUS - 1]
        members = np.concatenate([[seed], members[row[members] > 0]])
        free[members] = False
        if len(members) >= 3:
            sets.append(members)
    return sets


def _agree(poses: Array, p: Array, q: Array, tolerance: float) -> NDArray[np.bool_]:
    """(k, n) which of the n correspondences agree with each of (k, 4, 4) poses."""
    offsets = poses[:, :3, :3] @ p.T + poses[:, :3, 3:] - q.T
    return (offsets**2).sum(axis=1) < tolerance**2


def _fitted(p: Array, q: Array, weights: Array) -> Array:
    """(k, 4, 4) the rigid motions that bring (n, 3) p nearest to q, in least squares with each of (k, n) weights.

    Source
    ------
    W. Kabsch: A solution for the best rotation to relate two sets of vectors, Acta Crystallographica A32, 1976.
    """
    shares = weights / weights.sum(axis=1, keepdims=True)
    mean_p, mean_q = shares @ p, shares @ q
    moments = (shares[:, None, :] * p.T) @ q - mean_p[:, :, None] * mean_q[:, None, :]
    poses = np.tile(np.eye(4), (len(weights), 1, 1))
    poses[:, :3, :3] = nearest_rotations(moments).transpose(0, 2, 1)
    poses[:, :3, 3] = mean_q - (poses[:, :3, :3] @ mean_p[:, :, None])[:, :, 0]
    return poses


def nearest_rotations(matrices: Array) -> Array:
    """(k, 3, 3) the rotations nearest to (k, 3, 3) matrices; any of them where several are."""
    left, _, right = np.linalg.svd(matrices)
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    return left @ right
