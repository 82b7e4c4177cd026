"""Whether two sensors of a rig are no longer where it says: their pairs all differ from it, and all by the same."""

from collections.abc import Sequence

import numpy as np

from adagmm_fusion.pairs.record import PairRecord
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.lie import se_inverse, so_log

# Pairs that say so at least, each believed by itself.
LEAST_PAIRS = 2
# A difference that is at least so large [° and mm], so many times its deviation, and the same to this share of it.
LEAST_TURN, LEAST_WAY, TIMES, ALIKE = 0.5, 20.0, 5.0, 0.2


def moved_sensors_notes(records: Sequence[PairRecord], recording: Recording, said: Sequence[str] = ()) -> list[str]:
    """A line for every two sensors of which that is so, unless a note that was `said` doubts their given pose."""
    by_sensors: dict[tuple[str, str], list[PairRecord]] = {}
    for record in records:
        pair = recording.pairs[record.index]
        source, target = recording.entries[pair.source].sensor, recording.entries[pair.target].sensor
        if source != target and record.T_target_source_truth is not None:
            by_sensors.setdefault((source, target), []).append(record)
    notes = []
    for (source, target), pairs in by_sensors.items():
        found = [pair for pair in pairs if pair.trustworthy and pair.T_target_source is not None]
        of_rig = np.array([pair.T_target_source_truth for pair in pairs])
        fixed = np.allclose(of_rig, of_rig[0], rtol=0.0, atol=1e-6)
        if len(found) < LEAST_PAIRS or not fixed or any(note.startswith(f"the pose of {source} to") for note in said):
            continue
        differences = [se_inverse(of_rig[0]) @ np.array(pair.T_target_source) for pair in found]
        turns = np.degrees([so_log(D[:3, :3]) for D in differences])
        ways = 1000.0 * np.array([D[:3, 3] for D in differences])
        times = max(
            _times_alike(turns, [pair.rotation_deviation_deg for pair in found], LEAST_TURN),
            _times_alike(ways, [pair.translation_deviation_mm for pair in found], LEAST_WAY),
        )
        if times < TIMES:
            continue
        turn, way = (float(np.linalg.norm(values.mean(axis=0))) for values in (turns, ways))
        count = f"all {len(pairs)}" if len(found) == len(pairs) else f"{len(found)} of {len(pairs)}"
        notes.append(
            f"{count} pairs of {source} and {target} differ from their given pose by the same {turn:.1f}° and "
            f"{way:.0f} mm, {times:.0f} times the deviation: has a sensor moved since? see verify"
        )
    return notes


def _times_alike(values: np.ndarray, deviations: Sequence[float | None], least: float) -> float:
    """How many times their deviation the (n, 3) values all are the same; 0 where they are not, or small."""
    mean = values.mean(axis=0)
    size, spread = float(np.linalg.norm(mean)), float(np.linalg.norm(values - mean, axis=1).max())
    known = [deviation for deviation in deviations if deviation]
    return size / max(known) if len(known) == len(deviations) and size >= least and spread <= ALIKE * size else 0.0
