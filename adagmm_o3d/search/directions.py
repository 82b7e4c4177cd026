"""Poses proposed by the directions that surfaces face: rooms, streets and machines are made of few planes.

Two clouds of a room that share the floor and a wall agree in what these face, however little else they share and
wherever they start. So the directions that many points of either cloud face are laid on each other, two on two in every
way, and for each rotation all shifts are compared at once, see `trust.laying`.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.sampling import first_of_alike, some_of
from adagmm_o3d.search.features import Alike, Thinned, nearest_rotations
from adagmm_o3d.trust.laying import Facing, facing, facing_alike, laid_poses

# Points of either cloud that are asked.
ASKED = 400
# Directions are a cloud's where at least this share of its points faces them to within so much; the most of them.
FACING, WITHIN, DIRECTIONS = 0.02, math.radians(18.0), 4
# Means of the normals around a direction, each around the one before.
MEANS = 3
# Angles between two directions that are the same, and rotations that are.
SAME_COSINE, SAME_ROTATION = 0.15, math.radians(12.0)
# Below this absolute cosine two directions are at right angles, whatever their signs.
RIGHT_ANGLE = 0.1
# The edge of a cell of shifts, at least, in radii, and the shifts that are kept of a rotation.
EDGE, SHIFTS = 0.06, 3
# Of two directions that have no sign.
SIGNS = tuple(itertools.product((1.0, -1.0), repeat=2))


def direction_poses(alike: Alike) -> list[Array]:
    """Poses (4, 4) between two normalised clouds in space, those with most votes first; none where either faces fewer
    than two directions."""
    if alike.too_few:
        return []
    source, target = _facing(alike.source), _facing(alike.target)
    rotations = _rotations(_directions(source), _directions(target))
    if not len(rotations):
        return []
    return laid_poses(source, target, rotations, max(alike.edge, EDGE), SHIFTS)


def _facing(cloud: Thinned) -> Facing:
    """Of some of its points."""
    index = some_of(np.arange(len(cloud.points)), ASKED)
    return facing(cloud.points[index], cloud.normals[index])


def _directions(cloud: Facing) -> list[Array]:
    """Unit vectors (3,) that many normals face, of either sign, those that most face first."""
    normals = cloud.normals
    found: list[Array] = []
    left = np.full(len(normals), True)
    while len(found) < DIRECTIONS and left.any():
        direction = normals[int(np.argmax(np.where(left, cloud.alike, -1.0)))]
        for _ in range(MEANS):
            weights = facing_alike(normals @ direction) * left
            direction = np.linalg.eigh((normals * weights[:, None]).T @ normals)[1][:, 2]
        near = left & (np.abs(normals @ direction) > math.cos(WITHIN))
        if near.sum() < FACING * len(normals):
            break
        found.append(direction)
        left &= ~near
    return found


def _rotations(own: list[Array], other: list[Array]) -> Array:
    """(r, 3, 3) rotations that lay two of the own directions on two of the other's, in every way, each once."""
    laid = []
    for (a, b), (c, d) in itertools.product(itertools.combinations(own, 2), itertools.permutations(other, 2)):
        angle, onto = a @ b, c @ d
        if abs(abs(angle) - abs(onto)) > SAME_COSINE:
            continue
        right_angle = min(abs(angle), abs(onto)) < RIGHT_ANGLE
        laid += [(a, b, s * c, t * d) for s, t in SIGNS if right_angle or s * t * angle * onto > 0.0]
    if not laid:
        return np.empty((0, 3, 3))
    a, b, c, d = np.array(laid).transpose(1, 0, 2)
    moments = np.einsum("ri,rj->rij", c, a) + np.einsum("ri,rj->rij", d, b)
    rotations = nearest_rotations(moments + np.einsum("ri,rj->rij", np.cross(c, d), np.cross(a, b)))
    same = np.einsum("iab,jab->ij", rotations, rotations) > 1.0 + 2.0 * math.cos(SAME_ROTATION)
    return rotations[first_of_alike(same)]
