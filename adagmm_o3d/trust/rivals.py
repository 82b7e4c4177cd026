"""The mistake that a nearly symmetric shape invites: another pose, turned from here, explains the clouds as well.

A search from nearby never comes there. So the pose that was found is turned: by half a turn about each axis of the
matched shape, about each of what its surfaces face, as walls and floors do, and about others all around, as the axes of
a round shape are anybody's guess, and by quarter turns, as of a square room. What comes to lie near the target is
refined briefly, the best of that further, and compared. Clouds that lack two ends of a room turn about the middle of
neither: turned about what they face they are laid on each other anew.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import Limits, Start, pose_distance, run_starts
from adagmm_o3d.lie import so_exp
from adagmm_o3d.mixtures.merging import MergedMixture
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.sampling import some_of
from adagmm_o3d.trust.agreement import Surface
from adagmm_o3d.trust.judge import Judge, of_rival
from adagmm_o3d.trust.laying import Facing, facing, laid_poses

# Axes all around that half turns are tried about, and by how many points of the source and how near the target each
# turn is looked at [radii]; the turns that are followed, which differ by more than so much [rad].
AXES, LOOKED_AT, REACH, FOLLOWED, DIFFERENT = 40, 150, 0.12, 6, 0.5
# Points of either cloud that they are refined on, and the iterations: all of them at first, then the best.
POINTS, ITERATIONS, BEST = (250, 500), (12, 20), 3
SIGMA, UNMATCHED, FASTEST = 0.01, 0.4, 0.7
LIMITS = Limits(floor=1e-4, least_unmatched=0.05, relative_rmse=1e-4)
# What is nearer is the same pose, as of a round shape.
APART = 0.5
# Points of either cloud that say how clouds that are turned lie on each other, the edge of a cell of shifts at least
# [radii], and the shifts that are followed of each turn.
VOTING, EDGE, SHIFTS = 300, 0.1, 2
# In the plane, where there is one axis.
TURNS_IN_PLANE = (math.pi, 0.5 * math.pi, -0.5 * math.pi, 0.75 * math.pi, -0.75 * math.pi)


def margin_over_turned(judge: Judge, pose: Array, held: float) -> float:
    """By how much a pose (4, 4), at which so much holds, explains the judge's clouds better than any turned from there
    does [nats per point]; infinity where all of them lead back to it."""
    sides = judge.sides

    def others(poses: list[Array], stage: int) -> list[Array]:
        return [end for end in refined(sides, poses, stage, SIGMA) if pose_distance(end, pose) > APART]

    ends = others([*_turned(judge, pose), *_laid(judge, pose)], 0)
    if ends:
        ends = others(best_of(ends, judge.explained(sides, ends)), 1)
    margin = judge.confidence(pose, 1.0) - max((judge.confidence(end, 1.0) for end in ends), default=-math.inf)
    # One that explains as much as a right pose does may be right, however much more this one explains.
    own = float(judge.evidence([pose])[0])
    known = judge.known(own)
    least = of_rival(known, own)
    return min(margin, 0.0) if any(judge.may_be_right(end, least, held, known) for end in ends) else margin


def refined(sides: tuple[MergedMixture, MergedMixture], poses: list[Array], stage: int, sigma: float) -> list[Array]:
    """Where poses lead, each of them alike: roughly in stage 0, in stage 1 to the end."""
    source, target = (side.take(some_of(np.arange(len(side.points)), POINTS[stage])) for side in sides)
    starts = [Start(pose, sigma, UNMATCHED, FASTEST, ITERATIONS[stage], follow=0.0) for pose in poses]
    return [end.pose for end in run_starts(source, target, starts, limits=LIMITS, level=0)]


def best_of(poses: list[Array], explained: Array) -> list[Array]:
    """The few that explain the clouds best, of poses and (k,) how well each does."""
    return [poses[i] for i in np.argsort(-explained, kind="stable")[:BEST]]


def _turned(judge: Judge, pose: Array) -> list[Array]:
    """Poses (4, 4) turned from this one that take the source near the target, the nearest first."""
    source, target = judge.sides
    moved = source.points @ pose[:3, :3].T + pose[:3, 3]
    centre = moved.mean(axis=0)
    turns = np.array(_turns(moved, judge.surfaces[0].normals @ pose[:3, :3].T, source.dimension))
    few = moved[some_of(np.arange(len(moved)), LOOKED_AT)] - centre
    squares = NeighborIndex(target.points).query((few @ turns.transpose(0, 2, 1)).reshape(-1, 3) + centre)[1]
    near = np.exp(-squares.reshape(len(turns), -1) / (2.0 * REACH**2)).mean(axis=1)
    followed: list[Array] = []
    for turn in turns[np.argsort(-near, kind="stable")]:
        if all(np.trace(turn.T @ other) < 1.0 + 2.0 * math.cos(DIFFERENT) for other in followed):
            followed.append(turn)
        if len(followed) == FOLLOWED:
            break
    poses = np.tile(np.eye(4), (len(followed), 1, 1))
    poses[:, :3, :3] = followed
    poses[:, :3, 3] = centre - poses[:, :3, :3] @ centre
    return list(poses @ pose)


def _laid(judge: Judge, pose: Array) -> list[Array]:
    """Poses (4, 4) turned from this one by half a turn about what the surfaces face, and shifted to where most of them
    meet."""
    if judge.sides[0].dimension == 2:
        return []
    source, target = (_facing(surface) for surface in judge.surfaces)
    axes = np.linalg.eigh(source.normals.T @ source.normals)[1].T
    rotations = np.array([pose[:3, :3] @ so_exp(math.pi * axis) for axis in axes])
    return laid_poses(source, target, rotations, EDGE, SHIFTS)


def _facing(surface: Surface) -> Facing:
    """Of some of its points."""
    part = surface.some(VOTING)
    return facing(part.points, part.normals)


def _turns(points: Array, normals: Array, dimension: int) -> list[Array]:
    """Rotations (3, 3) by half turns and quarter turns of (n, 3) points with their normals."""
    if dimension == 2:
        return [so_exp(np.array([0.0, 0.0, angle])) for angle in TURNS_IN_PLANE]
    own = [*np.linalg.eigh(np.cov(points.T))[1].T, *np.linalg.eigh(normals.T @ normals)[1].T]
    turns = [*(so_exp(math.pi * axis) for axis in own), *_half_turns_around(AXES)]
    return turns + [so_exp(angle * axis) for axis in own for angle in (0.5 * math.pi, -0.5 * math.pi)]


@cache
def _half_turns_around(count: int) -> Array:
    """(count, 3, 3) half turns about axes spread evenly over half a sphere, on a spiral."""
    place = np.arange(count) + 0.5
    height, angle = place / count, math.pi * (1.0 + math.sqrt(5.0)) * place
    radius = np.sqrt(1.0 - height**2)
    axes = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return np.array([so_exp(math.pi * axis) for axis in axes])
