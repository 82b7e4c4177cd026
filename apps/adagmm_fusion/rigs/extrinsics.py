"""Do the poses of a rig's sensors, or of a path, look like something else: their inverse, or in millimetres?"""

from collections.abc import Iterator

import numpy as np

from adagmm_fusion.frames.pose_readings import AS_GIVEN, PosedPair, best_reading
from adagmm_fusion.recordings.frame_sequence import PairEntry, Recording
from adagmm_o3d.errors import AdaGMMError

# Pairs of two sensors that are looked at.
PAIRS = 3


def extrinsics_notes(recording: Recording) -> tuple[str, ...]:
    """A line for every two sensors whose given poses agree with the depth images only if they are read otherwise, or
    less than both at one place do."""
    by_sensors: dict[tuple[str, str], list[PairEntry]] = {}
    for pair in recording.pairs:
        source, target = recording.entries[pair.source], recording.entries[pair.target]
        by_sensors.setdefault((source.sensor, target.sensor), []).append(pair)
    notes = []
    for (moving, fixed), pairs in by_sensors.items():
        chosen = [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, PAIRS).astype(int))]
        best = best_reading(_posed(recording, chosen))
        whose, s, es = f"the pose of {moving} to {fixed}", "s", "es"
        if moving == fixed:
            whose, s, es = f"the poses of {moving}", "", ""
        if best.name != AS_GIVEN:
            notes.append(
                f"{whose} look{s} like {best.name}: read so, {100 * best.share:.0f} % of the points agree with the "
                f"other depth image, as given {100 * best.share_as_given:.0f} %"
            )
        elif best.share_at_one_place:
            notes.append(
                f"{whose} do{es} not fit: as given {100 * best.share_as_given:.0f} % of the points agree with the "
                f"other depth image, with both at one place {100 * best.share_at_one_place:.0f} %"
            )
    return tuple(notes)


def _posed(recording: Recording, pairs: list[PairEntry]) -> Iterator[PosedPair]:
    for pair in pairs:
        source, target = recording.entries[pair.source], recording.entries[pair.target]
        poses = source.T_world_camera, target.T_world_camera
        in_moving_rig = recording.moving and source.sensor != target.sensor  # the rig's own pose is between the two
        if in_moving_rig or poses[0] is None or poses[1] is None:
            if pair.T_target_source is None:
                continue
            poses = pair.T_target_source, np.eye(4)
        try:
            yield PosedPair(source.load(), target.load(), *poses)
        except AdaGMMError:
            continue  # whoever registers the pair says what is wrong
