"""Which points of the source have a partner in the target, at a pose: whatever led there.

A point has a partner where a point of the target is near: within a few times what the points are apart, and no nearer
than the bias of a depth sensor may keep them. What the covariances say plays no part beside flagging outliers: it would
be as narrow as the surfaces are thin, and the width that EM ended with depends on where it began.
"""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.spacing import spacing_of_whole
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.result import Partners

# A partner is within so many spacings of the coarser cloud, or within so many radii where that is farther. Measured on
# recorded, public and cut pairs: the overlap then is that of the true pose, on grids of a sixth of a hundredth of the
# radius, within 0.03 in the median.
SPACINGS, RADII = 3.0, 0.06
# How steeply the probability falls about that distance, and in how many times of it to nothing.
STEEPNESS, FARTHEST = 8, 2.0


def partners_at(source: Mixture, target: Mixture, pose: Array) -> Partners:
    """What a pose (4, 4) between normalised mixtures says of every input point of the source."""
    certain, among = (np.flatnonzero(mixture.variances <= FLAGGED) for mixture in (source, target))
    row_weights = np.zeros(len(source.kept))
    weights = np.zeros(len(source))
    if len(certain) and len(among):
        moved = source.points_at(certain) @ pose[:3, :3].T + pose[:3, 3]
        squares = NeighborIndex(target.points_at(among)).query(moved)[1][:, 0]
        reach = max(RADII, SPACINGS * max(spacing_of_whole(mixture) for mixture in (source, target)))
        near = squares < (FARTHEST * reach) ** 2
        weights[certain[near]] = 1.0 / (1.0 + (squares[near] / reach**2) ** (STEEPNESS // 2))
    row_weights[source.kept] = weights
    return Partners(float(weights.mean()), row_weights)


def no_partners(source: Mixture) -> Partners:
    """Of a pose that no pair speaks for."""
    return Partners(0.0, np.zeros(len(source.kept)))
