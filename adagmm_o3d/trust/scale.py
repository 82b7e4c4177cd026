"""Whether the clouds are of one size: the scale that their surfaces ask for at the pose, and how sure that is.

A few Gauss-Newton steps of point to plane from the final pose, with the scale free as a seventh direction; and from the
ratio of the clouds' radii, if clearly more of both meets there, and nearly all. Where the clouds share little, scale
and pose can make up for each other, and for the bias of a sensor: nothing is said there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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
# Where less than this share of all points has a partner that does not tell, nor fewer pairs than so many. Of a size far
# off nearly all must have one, and by so much more than at the pose as it is one that faces the same way.
LEAST_SHARE, LEAST_PAIRS, NEARLY_ALL, MORE = 0.75, 30, 0.85, 0.05
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


class Meeting(NamedTuple):
    """Points where either cloud meets the other, both ways: a point of the source by the target's normal, and one of
    the target by the source's, rows `across` along `axes` from the points `at` of the source, (m, 3).

    share : of all points, that are near one of the other cloud.    alike : (m,) bool, which of them face as it does.
    """

    at: Array
    axes: Array
    across: Array
    share: float
    alike: NDArray[np.bool_]

    def residuals(self, spacing: float) -> tuple[Array, Array]:
        """(m,) how far points are off their partners' surfaces, and what that weighs."""
        off = (self.across * self.axes).sum(axis=1)
        typical = typical_off(off[self.alike], spacing)
        return off, self.alike / (1.0 + (off / (ROBUST * typical)) ** 2)

    def motions(self) -> Array:
        """(m, 6) how far a unit of each motion (ω, v) takes the points along the axes."""
        return np.concatenate([np.cross(self.at, self.axes), self.axes], axis=1)


def estimate_scale(source: Surface, target: Surface, pose: Array, dimension: int) -> Scale | None:
    """The scale of the source at about a pose (4, 4) between normalised clouds; None where too little is shared, or the
    surfaces leave it free."""
    found, alike = _refined(source, target, pose, source.points.mean(axis=0), 0.0, LEAST_SHARE, dimension)
    if found is not None and found.differs:
        return found
    # Beyond what the points reach of each other, whole clouds of other sizes have other radii.
    (middle, radius), (to, radius_to) = (_extent(surface.points) for surface in (source, target))
    logarithm = math.log(radius_to / radius)
    if abs(logarithm) > NOTICED:
        centred = pose.copy()
        centred[:3, 3] = to - pose[:3, :3] @ middle
        scaled, more = _refined(source, target, centred, middle, logarithm, NEARLY_ALL, dimension)
        if scaled is not None and more > alike + MORE:
            return scaled
    return found


def _extent(points: Array) -> tuple[Array, float]:
    """The middle of the points, and how far they are off it, root mean square."""
    middle = points.mean(axis=0)
    return middle, math.sqrt(float(((points - middle) ** 2).sum(axis=1).mean()))


def _refined(
    source: Surface,
    target: Surface,
    pose: Array,
    about: Array,
    logarithm: float,
    least_share: float,
    dimension: int,
) -> tuple[Scale | None, float]:
    """From a pose, and the logarithm of a scale about a point of the source: the scale, None where less than
    `least_share` of the points have a partner at last; and the share of them whose partner faces as they do, in the
    last step there was."""
    spacing = max(source.spacing, target.spacing)
    centre = pose[:3, :3] @ about + pose[:3, 3]
    offsets, normals = (source.points - about) @ pose[:3, :3].T, source.normals @ pose[:3, :3].T
    free = [*FREE[dimension], 6]
    for number in range(STEPS):
        met = meet(math.exp(logarithm) * offsets, normals, target, centre, spacing)
        alike = float(met.alike.mean())
        if met.share < (least_share if number == STEPS - 1 else LEAST_SHARE) or met.alike.sum() < LEAST_PAIRS:
            return None, alike
        off, weights = met.residuals(spacing)
        # Half-way between the two of a pair: by one side alone, its noise would pass for size, and ask for less.
        outward = ((met.at + 0.5 * met.across) * met.axes).sum(axis=1, keepdims=True)
        rows = np.concatenate([met.motions(), outward], axis=1)[:, free]
        hessian = (rows * weights[:, None]).T @ rows
        hessian += 1e-9 * np.trace(hessian) * np.eye(len(free))
        delta = np.zeros(7)
        delta[free] = np.linalg.solve(hessian, rows.T @ (weights * off))
        step = se_exp(delta[:6])
        offsets = offsets @ step[:3, :3].T + math.exp(-logarithm) * step[:3, 3]
        normals = normals @ step[:3, :3].T
        logarithm += float(delta[6])
    inverse = np.linalg.inv(hessian)
    if weights.sum() * inverse[-1, -1] > LEAST_MOVED**-2.0:
        return None, alike
    covariance = blockwise_covariance(inverse, rows * (weights * (off - rows @ delta[free]))[:, None], met.at)
    return Scale(math.exp(logarithm), math.sqrt(float(covariance[-1, -1]))), alike


def blockwise_covariance(inverse: Array, scores: Array, at: Array) -> Array:
    """(k, k) of the end of Gauss-Newton steps, by the inverse Hessian (k, k) and the scores (m, k) of points (m, 3):
    what is off in one block is off as one."""
    block = block_numbers(at, BLOCK)
    sums = np.stack([np.bincount(block, weights=score) for score in scores.T], axis=1)
    covariance: Array = inverse @ (sums.T @ sums) @ inverse
    return covariance


def meet(moved: Array, normals: Array, target: Surface, centre: Array, spacing: float) -> Meeting:
    """Of the source's points less `centre`, and their normals."""
    fixed = target.points - centre
    to, squares = target.index.query(moved + centre)
    back, squares_back = NeighborIndex(moved).query(fixed)
    to, back = to[:, 0], back[:, 0]
    cosines = np.concatenate([(target.normals[to] * normals).sum(axis=1), (target.normals * normals[back]).sum(axis=1)])
    near = np.concatenate([squares[:, 0], squares_back[:, 0]]) < max(REACH * spacing, LEAST_REACH) ** 2
    return Meeting(
        np.concatenate([moved, moved[back]]),
        np.concatenate([target.normals[to], normals[back]]),
        np.concatenate([fixed[to] - moved, fixed - moved[back]]),
        float(near.mean()),
        near & (np.abs(cosines) > SAME_WAY),
    )
