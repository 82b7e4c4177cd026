"""Which motions that the shape leaves free the colours hold: slid along them, the points look different.

Only what is measured at the pose counts: where a pose is wrong, colours get no worse on the way from it, however rich
they are. So a painted wall is held where it lies and an unpainted or wrongly placed one is not.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.grouping import block_numbers
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.merging import FLAGGED
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.spacing import spacing_of_whole
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.sampling import some_of
from adagmm_o3d.trust.partners import RADII, SPACINGS

# How far the points are slid, in radii, and the edge of the cells that count once: neighbours look alike.
SLID, CELL = 0.1, 0.1
# How many points are slid, and from which probability on one has a partner.
ASKED, HAS_PARTNER = 2000, 0.5
# A motion is held if the colours lose so many nats by it, and so many standard deviations of what they lose.
LEAST_LOSS, SIGNIFICANT = 10.0, 5.0


def free_of_colours(
    source: Mixture, target: Mixture, pose: Array, colour: ColourModel, free: Array, matched: Array
) -> Array:
    """(f', k) orthonormal rows: the part of the (f, k) motions `free` that the colours do not hold either.

    Parameters
    ----------
    source, target : normalised mixtures with colours.   pose : (4, 4) between them.   free : orthonormal, see
    `observability.free_directions`.   matched : (M,) the probability of each source point to have a partner.
    """
    assert source.colours is not None and target.colours is not None
    among = np.flatnonzero(target.variances <= FLAGGED)
    asked = some_of(np.flatnonzero((source.variances <= FLAGGED) & (matched >= HAS_PARTNER)), ASKED)
    if not len(free) or not len(asked) or not len(among):
        return free
    index = NeighborIndex(target.points_at(among))
    seen = colour.scaled(source.colours[asked], of_source=True)
    others = colour.scaled(target.colours[among], of_source=False)
    points = source.points_at(asked) @ pose[:3, :3].T + pose[:3, 3]
    cells = block_numbers(points, CELL)

    reach = max(RADII, SPACINGS * max(spacing_of_whole(mixture) for mixture in (source, target)))

    def support(moved: Array) -> Array:
        """(n,) what the colours of the nearest points say [nats]; NaN where none is near."""
        nearest, squares = index.query(moved)
        half = ((seen - others[nearest[:, 0]]) ** 2).sum(axis=1)
        likely = np.exp(-np.minimum(half, colour.floor)) / colour.expected
        gained = np.log((1.0 - colour.lying) * likely + colour.lying)
        return np.where(squares[:, 0] < reach**2, gained, np.nan)

    at_pose = support(points)

    def losses(motion: Array) -> Array:
        """(cells,) mean loss of each by the motion, there and back."""
        twist = np.zeros(6)
        twist[FREE[source.dimension]] = motion
        total, counts = np.zeros((2, cells.max() + 1))
        for step in (SLID, -SLID):
            T = se_exp(step * twist)
            lost = at_pose - support(points @ T[:3, :3].T + T[:3, 3])
            known = np.isfinite(lost)
            total += np.bincount(cells[known], lost[known], len(total))
            counts += np.bincount(cells[known], minlength=len(total))
        return total / np.maximum(counts, 1.0)

    # The loss is taken for a quadratic form on the free motions: by those of two of them it is known as a whole.
    count = len(free)
    forms = np.zeros((cells.max() + 1, count, count))
    for i in range(count):
        forms[:, i, i] = losses(free[i])
    for i, j in combinations(range(count), 2):
        both = losses((free[i] + free[j]) / np.sqrt(2.0)) - losses((free[i] - free[j]) / np.sqrt(2.0))
        forms[:, i, j] = forms[:, j, i] = 0.5 * both
    _, motions = np.linalg.eigh(forms.sum(axis=0))
    along = np.einsum("ki,nkl,li->ni", motions, forms, motions)
    lost, deviation = along.sum(axis=0), np.sqrt((along**2).sum(axis=0))
    held = (lost > LEAST_LOSS) & (lost > SIGNIFICANT * deviation)
    return (free.T @ motions[:, ~held]).T
