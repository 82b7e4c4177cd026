"""The mistake that a mirror image invites: one cloud has an axis the other way round, and most of a body that is nearly
its own mirror image agrees all the same.

No motion makes up for that, and no pose looks wrong by itself. So the source is reflected, through the principal planes
of the pose that was found and with its principal axes onto the target's, refined briefly, and compared.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.mixtures.merging import MergedMixture
from adagmm_o3d.trust.judge import Judge
from adagmm_o3d.trust.rivals import best_of, refined

# The width that images are refined from.
SIGMA = 0.02
# An image that, refined roughly, explains the clouds worse by so much [nats per point] is far off, and left at that.
FAR_OFF = 1.5
# Which image of the source it is does not matter: a motion makes one of the other.
REFLECTION = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class MirrorImage:
    """pose : (4, 4) where the mirror image of the source lies on the target best.   margin : by how much they explain
    each other better there than the clouds do at the pose that was found [nats per point, both clouds together]; about
    0 of a body that is its own mirror image."""

    pose: Array
    margin: float


def fit_mirror_image(judge: Judge, pose: Array) -> MirrorImage:
    """The mirror image of the judge's source in place of the source at a pose (4, 4)."""
    source, target = judge.sides
    image = reflected(source)
    poses = refined((image, target), _image_poses(judge.sides, pose), 0, SIGMA)
    own, explained = judge.explained(judge.sides, [pose]), judge.explained((image, target), poses)
    if explained.max() > own.max() - FAR_OFF:
        # what was found is refined alike, so that only the shape decides
        own = judge.explained(judge.sides, [pose, *refined(judge.sides, [pose], 1, SIGMA)])
        poses = refined((image, target), best_of(poses, explained), 1, SIGMA)
        explained = judge.explained((image, target), poses)
    return MirrorImage(poses[int(explained.argmax())], float(explained.max() - own.max()))


def reflected(side: MergedMixture) -> MergedMixture:
    """The mirror image of a mixture."""
    return replace(
        side,
        points=side.points @ REFLECTION,
        covariances=REFLECTION @ side.covariances @ REFLECTION,
        spreads=REFLECTION @ side.spreads @ REFLECTION,
    )


def _image_poses(sides: tuple[MergedMixture, MergedMixture], pose: Array) -> list[Array]:
    """Poses (4, 4) at which the image of the source may lie on the target, roughly, when `pose` leads the source itself
    there."""
    dimension = sides[0].dimension
    moved, fixed = sides[0].points @ pose[:3, :3].T + pose[:3, 3], sides[1].points
    centre, axes, axes_fixed = moved.mean(axis=0), _principal_axes(moved, dimension), _principal_axes(fixed, dimension)
    # where the moved source goes from there: reflected, about its own centre or onto the target's
    ways = [(np.eye(3) - 2.0 * np.outer(axis, axis), centre) for axis in axes.T[:dimension]]
    for signs in itertools.product((1.0, -1.0), repeat=dimension):
        way = axes_fixed @ np.diag([*signs, 1.0][:3]) @ axes.T
        if np.linalg.det(way) < 0.0:
            ways.append((way, fixed.mean(axis=0)))
    poses = np.tile(np.eye(4), (len(ways), 1, 1))
    for of_image, (way, to) in zip(poses, ways, strict=True):
        of_image[:3, :3] = way @ pose[:3, :3] @ REFLECTION
        of_image[:3, 3] = way @ (pose[:3, 3] - centre) + to
    return list(poses)


def _principal_axes(points: Array, dimension: int) -> Array:
    """(3, 3) in columns; in the plane the two of the plane come first."""
    axes = np.eye(3)
    axes[:dimension, :dimension] = np.linalg.eigh(np.cov(points[:, :dimension].T))[1]
    return axes
