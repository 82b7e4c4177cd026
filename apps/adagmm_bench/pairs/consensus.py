"""What other libraries agree on, where a pair has no truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.pairs.trial import pose_difference

AGREE_DEG, AGREE_UNITS = 5.0, 0.1


def consensus_pose(records: Iterable[dict]) -> np.ndarray | None:
    """The pose in the middle of those that most other libraries agree on, on one pair; None where too few agree.

    At least two do, and one of them needs no start: local methods end in the same wrong pose from the same start. Ours
    have no say.
    """
    peers = [record for record in records if record["status"] == "ok" and not METHODS[record["method"]].ours]
    best: list[dict] = []
    for candidate in peers:
        agreeing = [record for record in peers if _agree(candidate, record)]
        enough = len(agreeing) > 1 and any(METHODS[record["method"]].anywhere for record in agreeing)
        if enough and len(agreeing) > len(best):
            best = agreeing
    if not best:
        return None
    poses = [np.array(record["T_target_source"]) for record in best]
    return min(poses, key=lambda T: sum(_difference(T, record)[1] for record in best))


def _agree(one: dict, other: dict) -> bool:
    degrees, displacement = _difference(np.array(one["T_target_source"]), other)
    return degrees <= AGREE_DEG and displacement <= AGREE_UNITS


def _difference(T: np.ndarray, record: dict) -> tuple[float, float]:
    return pose_difference(T, np.array(record["T_target_source"]), np.array(record["centre"]), record["unit"])


def judged_by_consensus(records: Sequence[dict], known: Iterable[dict], group: str) -> tuple[list[dict], list[str]]:
    """Records of pairs without a truth, with errors against the consensus and moved to a group of their own; all others
    as they are.

    known : all records there are, of methods that did not run this time too.

    Returns
    -------
    records, and the names of the pairs that were left out for want of a consensus.
    """
    open_pairs: dict[str, list[dict]] = {}
    for record in known:
        if record["rotation_error_deg"] is None:
            open_pairs.setdefault(record["problem"]["pair"], []).append(record)
    poses = {pair: consensus_pose(members) for pair, members in open_pairs.items()}
    judged, left_out = [], []
    for record in records:
        pair = record["problem"]["pair"]
        if record["rotation_error_deg"] is not None:
            judged.append(record)
        elif (T := poses[pair]) is None:
            left_out.append(pair)
        else:
            degrees, displacement = _difference(T, record)
            facts = record["problem"] | {"group": group}
            judged.append(record | {"problem": facts, "rotation_error_deg": degrees, "translation_error": displacement})
    return judged, list(dict.fromkeys(left_out))
