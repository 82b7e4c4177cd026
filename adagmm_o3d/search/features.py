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
from adagmm_o3d.grouping import Groups
from adagmm_o3d.kernels.cpu.consistency import shared_support
from adagmm_o3d.kernels.cpu.features import BINS, FEATURE, describe, scatter_around, two_nearest
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.sampling import some_of

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
TOLERANCE, TURN = 1.5, 0.35
# So many correspondences, each with the others that it shares most support with, are made into poses.
SEEDS, CONSENSUS = 30, 20
# Fits of a pose to all correspondences that agree with it.
FITS = 2


class Thinned(NamedTuple):
    """A cloud on an even grid: points (k, 3), unit normals (k, 3) of either sign, features (k, FEATURE)."""

    points: Array
    normals: Array
    features: NDArray[np.float32]


def feature_poses(source: Mixture, target: Mixture) -> list[Array]:
    """Poses (4, 4) between two normalised mixtures in space, most supported first; none where no shape is
    recognised."""
    edges = [mixture.kept_for("grid edge", partial(_grid_edge, mixture)) for mixture in (source, target)]
    edge = max(edges)
    moving, fixed = (
        # On its own grid a cloud looks the same to every other one.
        mixture.kept_for("thinned", partial(_thinned, mixture, edge)) if own == edge else _thinned(mixture, edge)
        for mixture, own in zip((source, target), edges, strict=True)
    )
    if min(len(moving.points), len(fixed.points)) < FEWEST:
        return []
    i, j = _correspondences(moving.features, fixed.features)
    p, q = moving.points[i], fixed.points[j]
    support = np.empty((len(p), len(p)), np.int32)
    shared_support(p, q, moving.normals[i], fixed.normals[j], TOLERANCE * edge, TURN, support)
    return _poses(p, q, support, TOLERANCE * edge)


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
    """(n,) a number for the cube of each point."""
    cells = (
        np.floor((points - points.min(axis=0)) / edge).astype(np.int64) if len(points) else np.empty((0, 3), np.int64)
    )
    return (cells[:, 0] << 42) + (cells[:, 1] << 21) + cells[:, 2]


def _thinned(mixture: Mixture, edge: float) -> Thinned:
    points = _some_points(mixture)
    groups = Groups(_cells(points, edge), np.ones(len(points)))
    means = np.ascontiguousarray(groups.means(points))
    scatter = np.empty((len(means), 3, 3))
    reach = max(NORMAL_RADIUS, math.sqrt(NORMAL_POINTS * len(means) / (math.pi * len(points))))
    scatter_around(points, means, reach * edge, scatter)
    normals = np.ascontiguousarray(np.linalg.eigh(scatter)[1][:, :, 0])
    features = np.empty((len(means), FEATURE))
    describe(means, normals, FEATURE_RADIUS * edge, features)
    return Thinned(means, normals, features.astype(np.float32))


def _correspondences(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Indices of the pairs that are nearest to each other, mutual ones first and then by how far the second best is."""
    there, least_there = _nearest_of_either_sign(a, b)
    back, least_back = _nearest_of_either_sign(b, a)
    i = np.concatenate([np.arange(len(a)), back])
    j = np.concatenate([there, np.arange(len(b))])
    ratio = np.concatenate([least[:, 0] / np.maximum(least[:, 1], 1e-12) for least in (least_there, least_back)])
    key, first, count = np.unique(i * len(b) + j, return_index=True, return_counts=True)
    order = np.lexsort((ratio[first], -count))[:CORRESPONDENCES]
    return np.divmod(key[order], len(b))


def _nearest_of_either_sign(
    own: NDArray[np.float32], others: NDArray[np.float32]
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """For each feature the nearest other, whichever way that one's normal points; squared distances of the best two."""
    turned = others.copy()
    turned[:, :BINS], turned[:, 2 * BINS :] = others[:, BINS - 1 :: -1], others[:, : 2 * BINS - 1 : -1]
    best, least = np.empty((2, len(own)), np.intp), np.empty((2, len(own), 2), np.float32)
    for k, table in enumerate((others, turned)):
        two_nearest(own, np.ascontiguousarray(table.T), best[k], least[k])
    which = (least[1, :, 0] < least[0, :, 0]).astype(np.intp)
    each = np.arange(len(own))
    return best[which, each], np.sort(np.concatenate(least, axis=1), axis=1)[:, :2]


def _poses(p: Array, q: Array, support: NDArray[np.int32], tolerance: float) -> list[Array]:
    """The poses of the sets of correspondences p -> q that support each other, most supported first."""
    free = np.full(len(p), True)
    found: list[tuple[int, Array]] = []
    for seed in np.argsort(-support.sum(axis=1), kind="stable"):
        if len(found) == SEEDS:
            break
        if not free[seed]:
            continue
        free[seed] = False
        row = support[seed].astype(np.float64)
        row[seed] = row.max() + 1.0
        members = np.argsort(-row, kind="stable")[:CONSENSUS]
        members = members[row[members] > 0.0]
        if len(members) < 3:
            continue
        pose = _fitted(p[members], q[members], row[members])
        agree = _agree(pose, p, q, tolerance)
        for _ in range(FITS):
            if agree.sum() < 3:
                break
            pose = _fitted(p[agree], q[agree], np.ones(int(agree.sum())))
            agree = _agree(pose, p, q, tolerance)
        found.append((int(agree.sum()), pose))
        free &= ~agree
    return [pose for _, pose in sorted(found, key=lambda item: -item[0])]


def _agree(pose: Array, p: Array, q: Array, tolerance: float) -> NDArray[np.bool_]:
    offsets = p @ pose[:3, :3].T + pose[:3, 3] - q
    return (offsets**2).sum(axis=1) < tolerance**2


def _fitted(p: Array, q: Array, weights: Array) -> Array:
    """(4, 4) the rigid motion that brings (n, 3) p nearest to q, in weighted least squares.

    Source
    ------
    W. Kabsch: A solution for the best rotation to relate two sets of vectors, Acta Crystallographica A32, 1976.
    """
    shares = weights / weights.sum()
    mean_p, mean_q = shares @ p, shares @ q
    left, _, right = np.linalg.svd((p - mean_p).T @ ((q - mean_q) * shares[:, None]))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    pose = np.eye(4)
    pose[:3, :3] = (left @ mirror @ right).T
    pose[:3, 3] = mean_q - pose[:3, :3] @ mean_p
    return pose
