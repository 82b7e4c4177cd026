"""Whether the clouds are the same points: then each of them holds the pose in every direction, whatever the surface."""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.spacing import spacing_of
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.sampling import some_of

# Points that are asked, and how near its copy each is, in spacings.
ASKED, SAME = 1000, 0.05
# The share of them that has one, and the share that may have one when all are shifted by a mesh: a lattice that slides
# by one is on itself again.
COPIED, REPEATED = 0.9, 0.5
# Shifts that are tried: from so many points to so many neighbours.
SHIFTED, NEIGHBORS = 5, 4


def are_copies(source: Mixture, target: Mixture, pose: Array) -> bool:
    """Whether the points of the source at a pose (4, 4) are those of the target, and are no lattice."""
    certain, among = (np.flatnonzero(mixture.variances <= FLAGGED) for mixture in (source, target))
    if len(certain) == 0 or len(among) == 0:
        return False
    points = source.points_at(some_of(certain, ASKED)) @ pose[:3, :3].T + pose[:3, 3]
    fixed = np.ascontiguousarray(target.points_at(among))
    index = NeighborIndex(fixed)
    same_sq = (SAME * spacing_of(fixed)) ** 2

    def copied(shift: Array) -> float:
        return float((index.query(points + shift)[1][:, 0] < same_sq).mean())

    if not copied(np.zeros(3)) >= COPIED:
        return False
    some = some_of(np.arange(len(points)), SHIFTED)
    around = fixed[index.query(points[some], NEIGHBORS + 1)[0][:, 1:]]
    shifts = (around - points[some, None]).reshape(-1, 3)
    return all(copied(shift) < REPEATED for shift in shifts)
