"""Where the search begins: one wide start, which draws centroids together, and narrow ones around it, for clouds that
overlap in part and whose centroids therefore lie apart."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import Start
from adagmm_o3d.lie import so_exp

# How far the starts stand around a pose, in normalised coordinates. Two clouds of which each lost 30 % on a side have
# centroids up to one radius apart.
RINGS = ((0.25, 6), (0.5, 12), (0.75, 12), (1.0, 16))
# How far they are turned, about an axis and about the diagonal between three.
TURN, DIAGONAL_TURN = math.radians(45.0), math.radians(75.0)
# A sensor turned in place: how far, and in which steps.
IN_PLACE, IN_PLACE_STEP = math.radians(45.0), math.radians(15.0)
SIDES = np.concatenate([np.eye(3), -np.eye(3)])
DIAGONALS = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) / math.sqrt(3.0)


def wide(pose: Array) -> Start:
    """σ starts so large that every point sees all others, and never falls below what the residuals say: this has the
    large basin of the paper's rule."""
    return Start(pose, sigma=0.3, unmatched=0.1, fastest=0.75, iterations=20, follow=1.0)


def narrow(pose: Array) -> Start:
    """For partial overlap: σ starts small and falls whatever the residuals say, as points without a partner make these
    large."""
    return Start(pose, sigma=0.02, unmatched=0.3, fastest=0.6, iterations=4, follow=0.0)


def turned(pose: Array) -> Start:
    """For rotations beyond the basin of the wide start."""
    return Start(pose, sigma=0.05, unmatched=0.1, fastest=0.5, iterations=4, follow=0.0)


def near(pose: Array) -> list[Start]:
    """For a pose that the caller gave: three small σ to begin with, at none of which a point sees far."""
    return [
        Start(pose, sigma, unmatched=0.3, fastest=0.77, iterations=20, follow=0.0) for sigma in (0.001, 0.004, 0.015)
    ]


def turned_in_place(source: Array, target: Array) -> list[Array]:
    """Poses (4, 4) that bring the viewpoints (3,) of both clouds together, turned up to IN_PLACE against each other."""
    poses = []
    for turn in _ball():
        pose = np.eye(4)
        pose[:3, :3] = so_exp(turn)
        pose[:3, 3] = target - pose[:3, :3] @ source
        poses.append(pose)
    return poses


@cache
def _ball() -> Array:
    """(k, 3) rotation vectors up to IN_PLACE, IN_PLACE_STEP apart."""
    reach = np.arange(-IN_PLACE, IN_PLACE + 1e-9, IN_PLACE_STEP)
    turns = np.array(list(itertools.product(reach, repeat=3)))
    return turns[(turns**2).sum(axis=1) <= IN_PLACE**2 + 1e-9]


def around(pose: Array, dimension: int) -> list[Start]:
    """Narrow starts at a pose and shifted from it, and starts turned about axes and diagonals."""
    shifts, rotations = _shifts(dimension), _rotations(dimension)
    shifted = np.tile(pose, (len(shifts), 1, 1))
    shifted[:, :3, 3] += shifts
    # about the source's own centroid
    rotated = np.tile(pose, (len(rotations), 1, 1))
    rotated[:, :3, :3] = rotations @ pose[:3, :3]
    return [*map(narrow, shifted), *map(turned, rotated)]


@cache
def _rotations(dimension: int) -> Array:
    """(k, 3, 3)"""
    turns = np.concatenate([TURN * SIDES, DIAGONAL_TURN * DIAGONALS]) if dimension == 3 else TURN * SIDES[2::3]
    return np.array([so_exp(turn) for turn in turns])


@cache
def _shifts(dimension: int) -> Array:
    """(k, 3) shifts that cover those of the centroids of clouds that overlap in part, the zero first."""
    if dimension == 2:
        rings = [_ring(radius, count) for radius, count in RINGS]
        return np.concatenate([np.zeros((1, 3)), *rings])
    return np.concatenate([np.zeros((1, 3)), 0.3 * SIDES, 0.5 * DIAGONALS, 0.6 * SIDES, 0.9 * DIAGONALS, 0.9 * SIDES])


def _ring(radius: float, count: int) -> Array:
    angles = 2.0 * np.pi / count * np.arange(count)
    return radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
