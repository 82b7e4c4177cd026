"""Whether a recording's poses are in another unit than its depth: rotations agree with what is registered, and all ways
are so many times too long or short.
"""

from collections.abc import Sequence

import numpy as np

from adagmm_fusion.pairs.plausibility import WAYS_LOOK
from adagmm_fusion.pairs.record import PairRecord
from adagmm_o3d.evaluation import pose_errors

# Pairs that say so at least; each is believed by itself, turned right [°], and has moved [m].
LEAST_PAIRS, TURNED_RIGHT, LEAST_WAY = 3, 1.0, 0.02
# A factor further than this from 1, about which the pairs differ no more than this.
OTHER, ALIKE = 0.2, 0.15


def scaled_ways_notes(records: Sequence[PairRecord], said: Sequence[str] = ()) -> list[str]:
    """A line where that is so, unless a note that was `said` tells it by the depth images alone."""
    if any(note.startswith(WAYS_LOOK) for note in said):
        return []
    factors = [factor for record in records if (factor := _factor(record)) is not None]
    if len(factors) < LEAST_PAIRS:
        return []
    factor = float(np.median(factors))
    alike = float(np.median(np.abs(np.array(factors) / factor - 1.0)))
    if abs(np.log(factor)) < np.log1p(OTHER) or alike > ALIKE:
        return []
    wrong = f"{1.0 / factor:.3g} times too long" if factor < 1.0 else f"{factor:.3g} times too short"
    return [
        f"{WAYS_LOOK} {wrong}: of {len(factors)} pairs the rotations are as registered, and all translations differ "
        "by that; are poses and depth in one unit?"
    ]


def _factor(record: PairRecord) -> float | None:
    """What a pair's true translation is to be multiplied by to be as long as the registered one."""
    if record.T_target_source is None or record.T_target_source_truth is None or not record.trustworthy:
        return None
    found, true = np.array(record.T_target_source), np.array(record.T_target_source_truth)
    ways = float(np.linalg.norm(found[:3, 3])), float(np.linalg.norm(true[:3, 3]))
    if ways[0] < LEAST_WAY or ways[1] == 0.0 or pose_errors(true, found).rotation_deg > TURNED_RIGHT:
        return None
    return ways[0] / ways[1]
