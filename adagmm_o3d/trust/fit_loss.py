"""How much worse two surfaces fit each other at another pose, where both poses bring them together.

What has no partner at either pose says nothing here: only how far points are off the other surface counts, whether more
of it or less is met.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.grouping import block_numbers
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.sampling import distinct_places, some_of
from adagmm_o3d.trust.agreement import NEAR, NEIGHBORS, Surface, typical_off

# The edge of the cells that count once, in radii: what is off in one is off as one.
CELL = 0.1
# How many points of either cloud are looked at, and how far from the other a point may be that is compared, in radii
# and beyond the reach of an agreement.
ASKED, FARTHER = 4000, 0.1
# A loss of so many standard deviations of what the cells say is one.
SIGNIFICANT = 3.0
# Divides what is zero itself.
TINY = 1e-300


class FitLoss:
    """By how much worse the points of one surface fit another after further motions from a pose (4, 4).

    known : (n,) which of its points the pose brings to where the other surface goes on.
    """

    def __init__(self, own: Surface, other: Surface, pose: Array) -> None:
        self._other = other
        self._points = own.points @ pose[:3, :3].T + pose[:3, 3]
        self._cells = block_numbers(self._points, CELL)
        at_pose, self.known = self._off(self._points)
        if self.known.any():
            self._typical = typical_off(at_pose[self.known], max(own.spacing, other.spacing))
            self._cost = np.log1p((at_pose / self._typical) ** 2)

    def of(self, motion: Array) -> float:
        """After a motion (4, 4), in standard deviations; 0 where the pose knows of no point."""
        if not self.known.any():
            return 0.0
        off, still_known = self._off(self._points @ motion[:3, :3].T + motion[:3, 3])
        both = self.known & still_known
        losses = np.where(both, np.log1p((off / self._typical) ** 2) - self._cost, 0.0)
        means = np.bincount(self._cells, losses) / np.maximum(np.bincount(self._cells, both), 1.0)
        return float(means.sum() / max(np.sqrt((means**2).sum()), TINY))

    def _off(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Of (n, 3) points, how far each is off the other's surface, and whether that goes on there."""
        nearest, squares, off = self._other.beside(points)
        reach = NEAR * self._other.spacing + FARTHER
        return off, ~self._other.ends[nearest] & (squares < reach**2)


def some_surface(mixture: Mixture) -> Surface | None:
    """That of some of its points; None of too few to have one."""
    certain = some_of(np.flatnonzero(mixture.variances <= FLAGGED), ASKED)
    points = mixture.points_at(certain)
    points = points[np.sort(distinct_places(points))]
    return Surface(points, mixture.dimension) if len(points) > NEIGHBORS[mixture.dimension] else None
