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

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.m_step import FREE
from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.trust.fit_loss import SIGNIFICANT, FitLoss, some_surface

# How far the points are slid, in radii.
SLID = tuple(0.05 * step for step in range(2, 17))
# A slide fits worse if its loss is significant, see `fit_loss`: of wrong poses, free by the normals, the least of the
# losses was never above 2.4; of right ones with detail it is 3.3 and more. It may not fall to this share of what it was
# before: there, what repeats itself begins to fit again.
AGAIN = 0.5


def free_of_detail(source: Mixture, target: Mixture, pose: Array, free: Array) -> Array:
    """(f', k) orthonormal rows: the motions `free` (f, k), or none of them if details hold all.

    Parameters
    ----------
    source, target : normalised mixtures.   pose : (4, 4) between them.   free : orthonormal, see
    `observability.free_directions`.
    """
    if not len(free):
        return free
    own, other = some_surface(source), some_surface(target)
    if own is None or other is None:
        return free
    fit = FitLoss(own, other, pose)

    def loss(motion: Array) -> float:
        twist = np.zeros(6)
        twist[FREE[source.dimension]] = motion
        return fit.of(se_exp(twist))

    def held(motion: Array) -> bool:
        largest = 0.0
        for step in SLID:
            lost = loss(step * motion)
            if lost < max(SIGNIFICANT, AGAIN * largest):
                return False
            largest = max(largest, lost)
        return True

    return free[:0] if all(held(sign * motion) for motion in _fan(free) for sign in (1.0, -1.0)) else free


def _fan(free: Array) -> list[Array]:
    """The motions, and those half-way between two of them."""
    pairs = combinations(free, 2)
    return [*free, *((one + sign * other) / np.sqrt(2.0) for one, other in pairs for sign in (1.0, -1.0))]
