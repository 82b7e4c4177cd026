"""The mistake that a repeating shape invites: slid along itself by a door or a bay, it fits as well.

Which of its equal places is the right one, the parts that the clouds share do not tell, and those that they do not
share cannot. So the pose is slid along the directions that fewest surfaces face. Where the surfaces part and, farther
on, agree again as they did, though much of them still meets, the shape repeats itself.
"""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.runs import pose_distance
from adagmm_o3d.trust.agreement import Surface, held_and_share
from adagmm_o3d.trust.judge import Judge
from adagmm_o3d.trust.rivals import SIGMA, refined

# Points of the source that are asked; the steps of a slide and how far it goes, in radii.
ASKED, STEP, FARTHEST = 300, 0.05, 1.6
# What may be a repetition: from its least on, what holds rises by so much, while so much still meets; in units of what
# it is at the pose.
RISES, STILL_MEETS = 0.06, 0.5
# Refined, it is one if so much holds, so much more than the least between, and it lies so far away still.
AGAIN, MORE, AWAY = 0.85, 0.25, 0.25


def repeats_itself(judge: Judge, source: Surface, target: Surface, pose: Array) -> bool:
    """Whether the judge's clouds, with these surfaces, agree at a pose (4, 4) no better than slid from there."""
    few = source.some(ASKED)
    at_pose = held_and_share(few, target, pose)
    if 0.0 in at_pose:
        return False
    normals = np.concatenate([target.normals, few.normals @ pose[:3, :3].T])
    weakest = np.linalg.eigh(normals.T @ normals)[1][:, :2].T
    slides = [
        slide for axis in weakest for sign in (1.0, -1.0) for slide in _slides(few, target, pose, sign * axis, at_pose)
    ]
    if not slides:
        return False
    ends = refined(judge.sides, [slide for slide, _ in slides], 0, SIGMA)
    held, share = held_and_share(source, target, pose)
    for end, (_, least) in zip(ends, slides, strict=True):
        now, meets = held_and_share(source, target, end)
        if now >= max(AGAIN, least + MORE) * held and meets >= STILL_MEETS * share and pose_distance(end, pose) > AWAY:
            return True
    return False


def _slides(
    source: Surface, target: Surface, pose: Array, axis: Array, at_pose: tuple[float, float]
) -> list[tuple[Array, float]]:
    """Poses slid along an axis to where more holds than before, and the least that held on the way there, in units of
    what holds `at_pose`."""
    held, share = at_pose
    slid, holds = [], []
    for distance in np.arange(STEP, FARTHEST, STEP):
        moved = pose.copy()
        moved[:3, 3] += distance * axis
        now, meets = held_and_share(source, target, moved)
        if meets < STILL_MEETS * share:
            break
        slid.append(moved)
        holds.append(now / held)
    least = np.minimum.accumulate(holds) if holds else np.empty(0)
    return [
        (slid[i], float(least[i]))
        for i in range(1, len(holds) - 1)
        if holds[i] >= max(holds[i - 1], holds[i + 1], least[i] + RISES)
    ]
