"""Whether details hold the motions that the surfaces as a whole leave free: slid along them, the clouds fit clearly
worse.

A door frame along a corridor turns few normals, so that next to nothing seems to hold the pose (`observability`), and
yet it fits in one place alone. Only what is measured at the pose counts: slid away from it, the cloud has to fit
clearly worse, both ways and all the way, most of a radius. So what repeats itself within that holds nothing, and at a
wrong pose, from where some way leads to a better fit, nothing does.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.grouping import block_numbers
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.sampling import some_of
from adagmm_o3d.trust.agreement import NEAR, NEIGHBORS, Surface, typical_off

# How far the points are slid, in radii, and the edge of the cells that count once: what is off in one is off as one.
SLID, CELL = tuple(0.05 * step for step in range(2, 17)), 0.1
# How many points of either cloud are looked at, and how far from the other a point may be that is compared, in radii
# and beyond the reach of an agreement.
ASKED, FARTHER = 4000, 0.1
# A slide fits worse if its loss is so many standard deviations of what the cells say: of wrong poses, free by the
# normals, the least of the losses was never above 2.4; of right ones with detail it is 3.3 and more. It may not fall
# to this share of what it was before: there, what repeats itself begins to fit again.
SIGNIFICANT, AGAIN = 3.0, 0.5
# Divides what is zero itself.
TINY = 1e-300


def free_of_detail(source: Mixture, target: Mixture, pose: Array, free: Array) -> Array:
    """(f', k) orthonormal rows: the motions `free` (f, k), or none of them if details hold all.

    Parameters
    ----------
    source, target : normalised mixtures.   pose : (4, 4) between them.   free : orthonormal, see
    `observability.free_directions`.
    """
    if not len(free):
        return free
    own, other = _surface_of(source), _surface_of(target)
    if own is None or other is None:
        return free
    points = own.points @ pose[:3, :3].T + pose[:3, 3]
    cells = block_numbers(points, CELL)
    at_pose, known = _off(other, points)
    if not known.any():
        return free
    typical = typical_off(at_pose[known], max(own.spacing, other.spacing))
    cost = np.log1p((at_pose / typical) ** 2)

    def loss(motion: Array) -> float:
        """By a motion, in standard deviations."""
        twist = np.zeros(6)
        twist[FREE[source.dimension]] = motion
        slide = se_exp(twist)
        off, still_known = _off(other, points @ slide[:3, :3].T + slide[:3, 3])
        both = known & still_known
        losses = np.where(both, np.log1p((off / typical) ** 2) - cost, 0.0)
        means = np.bincount(cells, losses) / np.maximum(np.bincount(cells, both), 1.0)
        return float(means.sum() / max(np.sqrt((means**2).sum()), TINY))

    def held(motion: Array) -> bool:
        largest = 0.0
        for step in SLID:
            lost = loss(step * motion)
            if lost < max(SIGNIFICANT, AGAIN * largest):
                return False
            largest = max(largest, lost)
        return True

    return free[:0] if all(held(sign * motion) for motion in _fan(free) for sign in (1.0, -1.0)) else free


def _surface_of(mixture: Mixture) -> Surface | None:
    """That of some of its points; None of too few to have one."""
    certain = some_of(np.flatnonzero(mixture.variances <= FLAGGED), ASKED)
    enough = len(certain) > NEIGHBORS[mixture.dimension]
    return Surface(mixture.points_at(certain), mixture.dimension) if enough else None


def _off(other: Surface, points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Of (n, 3) points, how far each is off the other's surface, and whether that goes on there."""
    nearest, squares, off = other.beside(points)
    return off, ~other.ends[nearest] & (squares < (NEAR * other.spacing + FARTHER) ** 2)


def _fan(free: Array) -> list[Array]:
    """The motions, and those half-way between two of them."""
    pairs = combinations(free, 2)
    return [*free, *((one + sign * other) / np.sqrt(2.0) for one, other in pairs for sign in (1.0, -1.0))]
