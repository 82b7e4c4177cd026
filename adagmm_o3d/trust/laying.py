"""Turned clouds laid on each other: for each rotation all shifts are compared at once, by what faces alike.

What faces a rare direction, a door frame say, tells more of a shift than the floor does, and counts for more.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cpu.votes import vote_for_shifts

# How sharply normals are told apart: two this far apart count e times less for one direction.
CONCENTRATION = 1.0 / math.sin(math.radians(7.5)) ** 2
# The absolute cosine of normals that agree, and about how many cells of shifts there are at most: far points make cells
# larger, not more.
AGREE, CELLS = math.cos(math.radians(20.0)), 1 << 18


class Facing(NamedTuple):
    """Points (n, 3) with unit normals (n, 3) of either sign, and how many of these face where each does, itself among
    them (n,)."""

    points: Array
    normals: Array
    alike: Array


def facing(points: Array, normals: Array) -> Facing:
    """(n, 3) points with their (n, 3) normals."""
    return Facing(points, normals, facing_alike(normals @ normals.T).sum(axis=1))


def facing_alike(cosines: Array) -> Array:
    """How much two normals at such angles count for one direction."""
    return np.exp(CONCENTRATION * (cosines**2 - 1.0))


def laid_poses(source: Facing, target: Facing, rotations: Array, edge: float, shifts: int) -> list[Array]:
    """Poses (4, 4) of the source by (r, 3, 3) rotations, with the `shifts` of each that most votes are for; those with
    most votes first.

    edge : of a cell of shifts, at least, in radii.
    """
    extents = np.ptp(source.points @ rotations.transpose(0, 2, 1), axis=1) + np.ptp(target.points, axis=0)
    edge = max(edge, float(extents.prod(axis=1).max() / CELLS) ** (1.0 / 3.0))
    peaks = np.empty((len(rotations), shifts, 4))
    own, other = (np.column_stack([side.points, side.alike**-0.5]) for side in (source, target))
    vote_for_shifts(own, source.normals, other, target.normals, rotations, edge, AGREE, peaks)
    found = np.argwhere(peaks[:, :, 3] > 0.0)
    order = np.argsort(-peaks[found[:, 0], found[:, 1], 3], kind="stable")
    poses = np.tile(np.eye(4), (len(found), 1, 1))
    for pose, (rotation, shift) in zip(poses, found[order], strict=True):
        pose[:3, :3], pose[:3, 3] = rotations[rotation], peaks[rotation, shift, :3]
    return list(poses)
