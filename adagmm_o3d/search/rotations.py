"""The pose when nothing is known of it: a grid of rotations on coarse mixtures, thinned level by level by likelihood.

σ is forced down on every level but the last, so that each start ends in the optimum nearest to it and not in the one
that attracts most. No translations are tried: centroids that lie apart because the clouds overlap only in part are well
within what the first, wide σ sees.
"""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import End, Start, distinct, pose_distance
from adagmm_o3d.lie import so_exp
from adagmm_o3d.search.levels import Levels
from adagmm_o3d.search.schedule import Level

# Neighbours in a grid of 128 rotations are about 50° apart, which is within reach of σ = 0.1 [radius²] on both sides.
ROTATIONS, ANGLES = 128, 24
# The spiral's second constant, ψ⁴ = ψ + 4 (the first is √2).
PSI = 1.533751168755204288118041
# Two poses this far apart are clearly different: 12° or 0.3 radii.
APART_AMBIGUOUS = 0.3


def search_globally(levels: Levels) -> list[End]:
    """The likeliest poses between two clouds turned against each other in any way, their centroids not far apart.

    Returns
    -------
    Up to four ends, likeliest first, each with its σ and unmatched share for the refinement on all points; among them,
    where there is one, the best that is clearly different from the first (see `find.is_ambiguous`).
    """
    schedule = levels.schedule
    grid = schedule.grid
    starts = [
        Start(pose, grid.sigma or 0.1, 0.2, grid.fastest, grid.iterations, grid.follow)
        for pose in _grid(levels.source.dimension)
    ]
    ends = distinct(levels.run(grid, starts, 0), grid.kept, grid.apart)
    for number, level in enumerate((schedule.grid_merged, schedule.grid_ranking, schedule.grid_deciding)):
        ends = _best(levels.carry_on(level, ends, number), level)
    return ends


def rotation_grid(count: int) -> Array:
    """(count, 3, 3) rotations spread evenly over all of SO(3).

    Source
    ------
    M. Alexa: Super-Fibonacci Spirals: Fast, Low-Discrepancy Sampling of SO(3), CVPR 2022.
    """
    s = np.arange(count) + 0.5
    inner, outer = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2.0 * np.pi * s / math.sqrt(2.0), 2.0 * np.pi * s / PSI
    x, y, z, w = inner * np.sin(alpha), inner * np.cos(alpha), outer * np.sin(beta), outer * np.cos(beta)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _grid(dimension: int) -> Array:
    """(k, 4, 4) poses with common centroids."""
    if dimension == 3:
        rotations = rotation_grid(ROTATIONS)
    else:
        turns = 2.0 * np.pi / ANGLES * np.arange(ANGLES)
        rotations = np.array([so_exp(np.array([0.0, 0.0, turn])) for turn in turns])
    poses = np.tile(np.eye(4), (len(rotations), 1, 1))
    poses[:, :3, :3] = rotations
    return poses


def _best(ends: list[End], level: Level) -> list[End]:
    """The ends that go on from a level."""
    kept = distinct(ends, level.kept, level.apart)
    rivals = [end for end in ends if pose_distance(end.pose, kept[0].pose) > APART_AMBIGUOUS]
    if rivals and all(pose_distance(end.pose, kept[0].pose) <= APART_AMBIGUOUS for end in kept):
        kept.append(max(rivals, key=lambda end: end.log_likelihood))
    return kept
