"""The pose when nothing is known of it: a grid of rotations on coarse mixtures, thinned level by level by likelihood.

σ is forced down on every level but the last, so that each start ends in the optimum nearest to it and not in the one
that attracts most. No translations are tried: centroids that lie apart because the clouds overlap only in part are well
within what the first, wide σ sees.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.expectation import SIGMA_FLOOR
from adagmm_o3d.lie import so_exp
from adagmm_o3d.mixtures.merging import MergedMixture, merge, sample
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.search.runs import End, Limits, Start, distinct, joined, pose_distance, run_starts

# Neighbours in a grid of 128 rotations are about 50° apart, which is within reach of σ = 0.1 [radius²] on both sides.
ROTATIONS, ANGLES = 128, 24
# The spiral's second constant, ψ⁴ = ψ + 4 (the first is √2).
PSI = 1.533751168755204288118041
# Two poses this far apart (12° or 0.3 radii) that explain the clouds equally well to within this much [nats per point,
# both clouds added] cannot be told apart. Measured gaps: symmetric bodies sampled twice 0.00 to 0.17 (1 of 30 above),
# rooms 0.07 and more (4 of 60 below), the simulation's models 1.9 and more.
APART_AMBIGUOUS, AMBIGUOUS_GAP = 0.3, 0.15


@dataclass(frozen=True)
class _Level:
    """One level of the search: its mixtures, how EM runs there, and how many of its ends go on how far apart."""

    mixtures: tuple[MergedMixture, MergedMixture]
    limits: Limits
    fastest: float
    iterations: int
    follow: float
    kept: int
    apart: float

    def start(self, end: End, sigma: float) -> Start:
        return Start(end.pose, sigma, end.unmatched, self.fastest, self.iterations, self.follow)


def search_globally(source: Mixture, target: Mixture, *, volume: float) -> list[End]:
    """The likeliest poses between two clouds in any position to each other.

    Parameters
    ----------
    source, target : normalised mixtures (see `normalisation.normalise`), 2D or 3D.
    volume : that over which points without a partner are spread, see `expectation.OPEN_VOLUME`.

    Returns
    -------
    Up to four ends, likeliest first, each with its σ and unmatched share for the refinement on all points; among them,
    where there is one, the best that is clearly different from the first (see `is_ambiguous`).
    """
    grid, merged, ranking, deciding = _levels(source, target)
    starts = [Start(pose, 0.1, 0.2, grid.fastest, grid.iterations, grid.follow) for pose in _grid(source.dimension)]
    ends = run_starts(*grid.mixtures, starts, limits=grid.limits, volume=volume, level=0)
    ends = distinct(ends, grid.kept, grid.apart)
    ends = _carry_on(ends, [merged.start(end, 0.015) for end in ends], merged, volume, 0)
    ends = _carry_on(ends, [ranking.start(end, 4e-3) for end in ends], ranking, volume, 1)
    ends = _carry_on(ends, [deciding.start(end, end.sigma) for end in ends], deciding, volume, 2)
    return ends


def is_ambiguous(ends: list[End]) -> bool:
    """Whether two clearly different poses among the ends, likeliest first, explain the clouds equally well."""
    best = ends[0]
    return any(
        best.log_likelihood - end.log_likelihood < AMBIGUOUS_GAP
        and pose_distance(best.pose, end.pose) > APART_AMBIGUOUS
        for end in ends[1:]
    )


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


def _levels(source: Mixture, target: Mixture) -> tuple[_Level, _Level, _Level, _Level]:
    return (
        _Level((merge(source, 64), merge(target, 64)), Limits(1e-2, 0.05, 1e-4), 0.6, 5, 0.0, 32, 0.15),
        _Level((merge(source, 150), merge(target, 150)), Limits(2e-3, 0.05, 5e-4), 0.65, 6, 0.0, 8, 0.1),
        _Level((sample(source, 500), sample(target, 500)), Limits(1e-3, 0.05, 1e-3), 0.65, 6, 0.0, 3, 0.05),
        _Level((sample(source, 1000), sample(target, 1000)), Limits(SIGMA_FLOOR, 0.15, 4e-4), 0.5, 6, 1.0, 4, 0.0),
    )


def _carry_on(before: list[End], starts: list[Start], on: _Level, volume: float, level: int) -> list[End]:
    """The best of the ends of `starts` on a level, each with the way that led to its start put in front."""
    ends = run_starts(*on.mixtures, starts, limits=on.limits, volume=volume, level=level)
    after = joined(before, ends)
    kept = distinct(after, on.kept, on.apart)
    rivals = [end for end in after if pose_distance(end.pose, kept[0].pose) > APART_AMBIGUOUS]
    if rivals and all(pose_distance(end.pose, kept[0].pose) <= APART_AMBIGUOUS for end in kept):
        kept.append(max(rivals, key=lambda end: end.log_likelihood))
    return kept
