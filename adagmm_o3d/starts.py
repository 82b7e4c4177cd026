"""Where the search begins: one wide start, and narrow ones around it for what the wide one's pull to centres loses."""

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
    """σ falls from where everything sees everything, held up by the residuals: the large basin of the paper's rule."""
    return Start(pose, sigma=0.3, unmatched=0.1, fastest=0.75, iterations=20, follow=1.0)


def narrow(pose: Array) -> Start:
    """σ starts small and falls whatever the residuals say, which points without a partner hold up: partial overlap."""
    return Start(pose, sigma=0.02, unmatched=0.3, fastest=0.6, iterations=7, follow=0.0)


def turned(pose: Array) -> Start:
    """For rotations beyond the basin of the wide start."""
    return Start(pose, sigma=0.05, unmatched=0.1, fastest=0.6, iterations=7, follow=0.0)


def near(pose: Array) -> list[Start]:
    """For a pose that somebody has vouched for: σ from a few shares of a radius down, none of which can see far."""
    return [
        Start(pose, sigma, unmatched=0.3, fastest=0.8, iterations=30, follow=0.0) for sigma in (0.001, 0.004, 0.015)
    ]


def around(pose: Array, dimension: int) -> list[Start]:
    """Narrow starts at a pose and a third of the radius off, and starts turned by 45° about each axis."""
    shifts = [np.zeros(3), *(sign * SHIFT * AXES[i] for i in range(dimension) for sign in (1.0, -1.0))]
    rotation_axes = AXES if dimension == 3 else AXES[2:]
    rotations = [so_exp(sign * TURN * axis) for axis in rotation_axes for sign in (1.0, -1.0)]
    return [
        *(narrow(_shifted(pose, shift)) for shift in shifts),
        *(turned(_rotated(pose, rotation)) for rotation in rotations),
    ]


def _shifted(pose: Array, shift: Array) -> Array:
    shifted = pose.copy()
    shifted[:3, 3] += shift
    return shifted


def _rotated(pose: Array, rotation: Array) -> Array:
    """The source turned about its own centroid."""
    rotated = pose.copy()
    rotated[:3, :3] = rotation @ pose[:3, :3]
    return rotated
