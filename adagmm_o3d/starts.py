"""Where the search begins: one wide start, and narrow ones around it that find what the wide one's centroid pull loses."""

from __future__ import annotations

import math

import numpy as np

from .arguments import Array
from .lie import so_exp
from .start_search import Start

# How far the starts stand around a pose, in normalised coordinates.
SHIFT = 0.3
TURN = math.radians(45.0)
AXES = np.eye(3)


def wide(pose: Array) -> Start:
    """σ falls from where everything sees everything: the large basin of the paper's rule."""
    return Start(pose, sigma=0.3, unmatched=0.1, two_sided=False, fastest=0.8, iterations=20, follow=1.0)


def narrow(pose: Array) -> Start:
    """σ starts small and the weights demand agreement from both sides: for clouds of which only parts overlap."""
    return Start(pose, sigma=0.02, unmatched=0.3, two_sided=True, fastest=0.75, iterations=10, follow=0.0)


def turned(pose: Array) -> Start:
    """For rotations beyond the basin of the wide start."""
    return Start(pose, sigma=0.05, unmatched=0.1, two_sided=False, fastest=0.75, iterations=12, follow=0.0)


def at(pose: Array) -> list[Start]:
    """The starts that trust a pose."""
    return [wide(pose), narrow(pose)]


def around(pose: Array, dimension: int) -> list[Start]:
    """The starts that trust a pose to some 60° and a third of the radius."""
    directions = [sign * AXES[i] for i in range(dimension) for sign in (1.0, -1.0)]
    rotation_axes = AXES if dimension == 3 else AXES[2:]
    rotations = [so_exp(sign * TURN * axis) for axis in rotation_axes for sign in (1.0, -1.0)]
    return [
        *at(pose),
        *(narrow(_moved(pose, SHIFT * direction)) for direction in directions),
        *(turned(_rotated(pose, rotation)) for rotation in rotations),
    ]


def _moved(pose: Array, shift: Array) -> Array:
    moved = pose.copy()
    moved[:3, 3] += shift
    return moved


def _rotated(pose: Array, rotation: Array) -> Array:
    """The source turned about its own centroid."""
    turned_pose = pose.copy()
    turned_pose[:3, :3] = rotation @ pose[:3, :3]
    return turned_pose
