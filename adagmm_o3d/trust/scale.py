"""Whether the clouds are of one size: the scale that their surfaces ask for at the pose, and how sure that is.

A few Gauss-Newton steps of point to plane from the final pose, with the scale free as a seventh direction. Where the
clouds share little, scale and pose can make up for each other, and for the bias of a sensor: nothing is said there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.grouping import block_numbers
from adagmm_o3d.lie import se_exp
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.trust.agreement import SAME_WAY, Surface, typical_off

STEPS = 4
# Pairs of points nearer than so many spacings, or so many radii where that is more, as on a curve, whose points are
# closer: within it another size still finds its partners. Those off by so many times what most are off weigh a half.
REACH, LEAST_REACH, ROBUST = 2.0, 0.08, 2.0
# The edge of a block whose errors are one, in radii.
BLOCK = 0.25
# Fewer pairs than this share of all points do not tell, nor fewer than so many.
LEAST_SHARE, LEAST_PAIRS = 0.6, 30
# A scale moves the points along their normals by this share of a radius at least, in the mean and beyond what a pose
# can make up for, or it is not told from none: on a wall it moves them along the wall.
LEAST_MOVED = 0.05
# Sizes differ when the scale is off by more than sensors are, and by so many deviations.
NOTICED, SURE = 0.035, 5.0


@dataclass(frozen=True)
class Scale:
    """factor : by which the source has to be scaled to fit the target.   deviation : of its logarithm.   differs :
    whether that is another size."""

    factor: float
    deviation: float

    @property
    def differs(self) -> bool:
        off = abs(math.log(self.factor))
        return off > max(NOTICED, SURE * self.deviation)


def estimate_scale(source: Surface, target: Surface, pose: Array, dimension: int) -> Scale | None:
    """The scale of the source at about a pose (4, 4) between normalised clouds; None where too little is shared, or the
    surfaces leave it free."""
    spacing = max(source.spacing, target.spacing)
    centre = (source.points @ pose[:3, :3].T + pose[:3, 3]).mean(axis=0)
    offsets, normals = source.points @ pose[:3, :3].T + pose[:3, 3] - centre, source.normals @ pose[:3, :3].T
    fixed = target.points - centre
    free = [*FREE[dimension], 6]
    logarithm = 0.0
    for _ in range(STEPS):
        moved = math.exp(logarithm) * offsets
        to, squares = target.index.query(moved + centre)
        back, squares_back = NeighborIndex(moved).query(fixed)
        to, back = to[:, 0], back[:, 0]
        # both ways: a point of the source by the target's normal, and one of the target by the source's
        at = np.concatenate([moved, moved[back]])
        axes = np.concatenate([target.normals[to], normals[back]])
        across = np.concatenate([fixed[to] - moved, fixed - moved[back]])
        cosines = np.concatenate(
            [(target.normals[to] * normals).sum(axis=1), (target.normals * normals[back]).sum(axis=1)]
        )
        near = np.concatenate([squares[:, 0], squares_back[:, 0]]) < max(REACH * spacing, LEAST_REACH) ** 2
        near &= np.abs(cosines) > SAME_WAY
        if near.sum() < max(LEAST_PAIRS, LEAST_SHARE * len(near)):
            return None
        off = (across * axes).sum(axis=1)
        typical = typical_off(off[near], spacing)
        weights = near / (1.0 + (off / (ROBUST * typical)) ** 2)
        rows = np.concatenate([np.cross(at, axes), axes, (at * axes).sum(axis=1, keepdims=True)], axis=1)[:, free]
        hessian = (rows * weights[:, None]).T @ rows
        hessian += 1e-9 * np.trace(hessian) * np.eye(len(free))
        delta = np.zeros(7)
        delta[free] = np.linalg.solve(hessian, rows.T @ (weights * off))
        step = se_exp(delta[:6])
        offsets = offsets @ step[:3, :3].T + math.exp(-logarithm) * step[:3, 3]
        normals = normals @ step[:3, :3].T
        logarithm += float(delta[6])
    scores = rows * (weights * (off - rows @ delta[free]))[:, None]
    block = block_numbers(at, BLOCK)
    sums = np.stack([np.bincount(block, weights=score) for score in scores.T], axis=1)
    inverse = np.linalg.inv(hessian)
    if weights.sum() * inverse[-1, -1] > LEAST_MOVED**-2.0:
        return None
    deviation = math.sqrt(float((inverse @ (sums.T @ sums) @ inverse)[-1, -1]))
    return Scale(math.exp(logarithm), deviation)
