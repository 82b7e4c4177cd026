"""The mistake that a nearly symmetric shape invites: the same pose, half a turn off, explains the clouds as well.

A search from nearby never comes there, so the end that it found is turned by half a turn about each axis of the matched
shape, refined briefly, and compared.
"""

from __future__ import annotations

import math

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import Limits, Start, pose_distance, run_starts
from adagmm_o3d.lie import so_exp
from adagmm_o3d.mixtures.merging import MergedMixture
from adagmm_o3d.mixtures.sampling import some_of

# Points of either cloud that they are refined on, and how.
POINTS = 500
SIGMA, UNMATCHED, FASTEST, ITERATIONS = 0.01, 0.4, 0.7, 20
LIMITS = Limits(floor=1e-4, least_unmatched=0.05, relative_rmse=1e-4)
# What is nearer is the same pose, as of a round shape.
APART = 0.5


def half_turned(sides: tuple[MergedMixture, MergedMixture], pose: Array) -> list[Array]:
    """Where a pose (4, 4) between two normalised mixtures leads when it is turned by half a turn; other poses only."""
    source, target = (side.take(some_of(np.arange(len(side.points)), POINTS)) for side in sides)
    moved = source.points @ pose[:3, :3].T + pose[:3, 3]
    centre = moved.mean(axis=0)
    # in the plane the one axis there is
    axes = np.linalg.eigh(np.cov(moved.T))[1].T if source.dimension == 3 else np.eye(3)[2:]
    starts = []
    for axis in axes:
        turned = np.eye(4)
        turned[:3, :3] = so_exp(math.pi * axis)
        turned[:3, 3] = centre - turned[:3, :3] @ centre
        starts.append(Start(turned @ pose, SIGMA, UNMATCHED, FASTEST, ITERATIONS, follow=0.0))
    ends = run_starts(source, target, starts, limits=LIMITS, level=0)
    return [end.pose for end in ends if pose_distance(end.pose, pose) > APART]
