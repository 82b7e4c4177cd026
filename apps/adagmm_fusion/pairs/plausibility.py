"""What looks wrong in a recording before anything is registered: a line for each, with the likely cause."""

import filecmp
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np

from adagmm_fusion.formats.camera_files import OTHER_SIZE
from adagmm_fusion.frames.depth_checks import (
    NOT_BEYOND_M,
    UNIT_MISTAKES,
    color_offset,
    looks_like_disparity,
    looks_like_distance,
    nearer_than_cameras_see,
    unit_mistake,
)
from adagmm_fusion.frames.intrinsics_checks import LOOK_EXCHANGED, pixels_doubt, principal_point_doubt
from adagmm_fusion.frames.pose_readings import AGREEMENT_M, agreeing_share, clearly_better, sampled_points
from adagmm_fusion.frames.rgbd import RGBDFrame, RGBDPair
from adagmm_fusion.pairs.mirrored import looks_mirrored
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording
from adagmm_fusion.rigs.extrinsics import extrinsics_notes
from adagmm_o3d.errors import AdaGMMError

# Frames of a sensor, and pairs of two, that are looked at.
FRAMES, PAIRS = 4, 3
# What known ways are multiplied by to see whether the depth images agree better.
WAYS = np.geomspace(0.05, 20.0, 61)
# Frames of one moment further apart [s] than this, or than this and twice the time from frame to frame, are none: free
# running cameras are half of that time apart, and another frame would be nearer.
APART_S, APART_STEPS_S, APART_STEPS = 1.0, 0.1, 2.0
DEPTH_LOOKS = "the depth looks"
WAYS_LOOK = "the ways between the known poses look"


def recording_warnings(recording: Recording) -> tuple[str, ...]:
    """A line for each thing that looks wrong; loads a few frames. What cannot be read is left to whoever needs it."""
    warnings: list[str] = []
    near: list[str] = []
    for sensor in recording.sensors:
        own = [entry for entry in recording.entries if entry.sensor == sensor]
        frames = list(_loaded([own[i].load for i in _spread(len(own), FRAMES)]))
        found = [*sensor_warnings(frames), *_intrinsics_warnings(recording, frames)]
        warnings += [f"{sensor}: {text}" for text in found]
        if not any(text.startswith(DEPTH_LOOKS) for text in found) and (text := _near_warning(frames)) is not None:
            near.append(f"{sensor}: {text}")
        if (text := _frozen_warning(own)) is not None:
            warnings.append(f"{sensor}: {text}")
    warnings += _copied_warnings(recording)
    warnings += _time_warnings(recording)
    pairs = list(_loaded([lambda i=i: recording[i] for i in _spread(len(recording), PAIRS)]))
    for pair in pairs:
        if pair.source.sensor != pair.target.sensor and looks_mirrored(pair.source, pair.target):
            names = f"{pair.source.sensor} or {pair.target.sensor}"
            warnings.append(f"{names} looks mirrored: their features agree only if one image is flipped left to right")
            break
    known = [pair for pair in pairs if pair.T_target_source is not None and np.any(pair.T_target_source[:3, 3])]
    scale = None
    if known and not any("depth_scale" in text for text in warnings):
        scale = _scale_warning(known) or _ways_warning(known)
    # The known poses say by how much; without them all that can be said is that it is near.
    return (*warnings, *extrinsics_notes(recording), *(near if scale is None else [scale]))


def sensor_warnings(frames: Sequence[RGBDFrame]) -> list[str]:
    """What looks wrong in some frames of one sensor."""
    if not frames:
        return []
    warnings = []
    if looks_like_disparity(frames):
        warnings.append(
            f"{DEPTH_LOOKS} like disparity: planes are straight in it; depth is focal length x baseline / it"
        )
    elif looks_like_distance(frames):
        warnings.append(
            f"{DEPTH_LOOKS} like the distance along the ray: planes are straight if it is divided by the length of the "
            "ray, |(x, y, 1)|; convert it to depth along the optical axis"
        )
    elif (times := unit_mistake(frames)) is not None:
        scale = frames[0].depth_scale
        warnings.append(
            f"{DEPTH_LOOKS} {_times(times)}: its steps are not those of structured light at this depth; "
            f"depth_scale {scale:g} should be {scale * times:g}"
        )
    offset = color_offset(frames)
    if offset is not None and offset.mirrored:
        warnings.append("the colour image looks mirrored against the depth, left to right")
    elif offset is not None:
        length = np.hypot(offset.right_px, offset.down_px)
        warnings.append(
            f"the colour looks {length:.0f} px off its depth ({offset.right_px:+d} px to the right, "
            f"{offset.down_px:+d} px down); register the depth to the colour"
        )
    return warnings


def _intrinsics_warnings(recording: Recording, frames: Sequence[RGBDFrame]) -> list[str]:
    """What looks wrong in a sensor's intrinsics, unless the reader has said what they rather are."""
    said = any(text in note for note in recording.notes for text in (LOOK_EXCHANGED, OTHER_SIZE))
    checks = (pixels_doubt,) if said else (principal_point_doubt, pixels_doubt)
    doubts = ((check(frame.intrinsics) for frame in frames) for check in checks)
    return [doubt for each in doubts if (doubt := next(filter(None, each), None)) is not None]


def _frozen_warning(entries: Sequence[FrameEntry]) -> str | None:
    """Whether two consecutive frames have one depth image; a camera's noise makes no two the same. Only the first two
    are named, so that not all of many copies are read."""
    for one, other in _with_same_depth(pairwise(entries)):
        return (
            f"the depth files of {one.name} and {other.name} are the same, byte for byte: a camera that hung, "
            "copied files or nothing measured? leave out what is no frame of its own"
        )
    return None


def _copied_warnings(recording: Recording) -> list[str]:
    """A line for every two sensors that have one depth image at one moment, which is named as above."""
    warnings = []
    for one, other, moments in _moments(recording):
        for entry, _ in _with_same_depth(moments):
            warnings.append(
                f"{one} and {other}: their depth files of {entry.name} are the same, byte for byte: was one camera "
                "recorded twice, were files copied, or was nothing measured?"
            )
            break
    return warnings


def _time_warnings(recording: Recording) -> list[str]:
    """A line for every two sensors whose frames of one moment were not taken at one."""
    warnings = []
    for one, other, moments in _moments(recording):
        stamps = [(a.timestamp, b.timestamp) for a, b in moments if None not in (a.timestamp, b.timestamp)]
        times = np.array(stamps, dtype=np.float64).reshape(-1, 2)
        steps = np.abs(np.diff(times, axis=0))
        usual = float(np.median(steps, axis=0).min()) if steps.size else np.inf
        most = np.abs(times[:, 0] - times[:, 1]).max(initial=0.0)
        if most > min(APART_S, max(APART_STEPS_S, APART_STEPS * usual)):
            warnings.append(
                f"{one} and {other}: their frames of one moment are up to {most:.3g} s apart by their times: another "
                "moment's, or clocks that differ? what moved in between is at two places"
            )
    return warnings


def _moments(recording: Recording) -> Iterator[tuple[str, str, list[tuple[FrameEntry, FrameEntry]]]]:
    """Every two sensors with their frames of one name, which are of one moment."""
    by_sensor: dict[str, dict[str, FrameEntry]] = {sensor: {} for sensor in recording.sensors}
    for entry in recording.entries:
        by_sensor[entry.sensor].setdefault(entry.name, entry)
    for (one, own), (other, others) in combinations(by_sensor.items(), 2):
        yield one, other, [(entry, others[name]) for name, entry in own.items() if name in others]


def _with_same_depth(entries: Iterable[tuple[FrameEntry, FrameEntry]]) -> Iterator[tuple[FrameEntry, FrameEntry]]:
    for one, other in entries:
        if one.depth_file is not None and other.depth_file is not None and _same(one.depth_file, other.depth_file):
            yield one, other


def _same(one: Path, other: Path) -> bool:
    """Regular files of one content; read only if their sizes agree, and no further than to the first difference."""
    try:
        return filecmp.cmp(one, other, shallow=False)
    except OSError:  # the frame says so when it is asked for
        return False


def _near_warning(frames: Sequence[RGBDFrame]) -> str | None:
    """Whether all is so near that the depth rather has another unit."""
    median = nearer_than_cameras_see(frames)
    if median is None:
        return None
    return (
        f"{DEPTH_LOOKS} several times too small: half of it is nearer than {median:.2g} m and hardly any beyond "
        f"{NOT_BEYOND_M:g} m, where few depth cameras see; check depth_scale {frames[0].depth_scale:g}"
    )


def _scale_warning(known: Sequence[RGBDPair]) -> str | None:
    """Whether the known poses say that the depth has another unit: then it agrees only if it is scaled."""

    def share(times: float) -> float:
        scaled = [(_scaled(pair.source, times), _scaled(pair.target, times), pair.T_target_source) for pair in known]
        # Else whatever is brought very near agrees with any pose, as with those of another time.
        at_least_m = AGREEMENT_M / max(times, 1.0)
        return float(np.mean([agreeing_share(sampled_points(s), t, T, at_least_m) for s, t, T in scaled]))

    given = share(1.0)
    shares = {times: share(times) for times in UNIT_MISTAKES}
    best = max(shares, key=lambda times: shares[times])
    if not clearly_better(shares[best], given):
        return None
    return (
        f"{DEPTH_LOOKS} {_times(best)}: by the known poses {100 * shares[best]:.0f} % of the points agree if that is "
        f"put right, as it is {100 * given:.0f} %; check depth_scale"
    )


def _ways_warning(known: Sequence[RGBDPair]) -> str | None:
    """Whether the ways between known poses are all so many times too long or short for what the depth images show."""
    points = [sampled_points(pair.source) for pair in known]

    def share(times: float) -> float:
        shares = []
        for pair, sampled in zip(known, points, strict=True):
            assert pair.T_target_source is not None
            T = pair.T_target_source.copy()
            T[:3, 3] *= times
            shares.append(agreeing_share(sampled, pair.target, T))
        return float(np.mean(shares))

    given = share(1.0)
    shares = {float(times): share(times) for times in WAYS}
    best = max(shares, key=lambda times: shares[times])
    if not clearly_better(shares[best], given):
        return None
    wrong = f"{1 / best:.2g} times too long" if best < 1.0 else f"{best:.2g} times too short"
    return (
        f"{WAYS_LOOK} {wrong}: put right, {100 * shares[best]:.0f} % of the points agree, as "
        f"they are {100 * given:.0f} %; are poses and depth in one unit?"
    )


def _scaled(frame: RGBDFrame, times: float) -> RGBDFrame:
    return replace(frame, depth_scale=frame.depth_scale * times)


def _times(times: float) -> str:
    return f"{times:g} times too large" if times > 1 else f"{1 / times:g} times too small"


def _spread(count: int, most: int) -> list[int]:
    return [int(i) for i in np.unique(np.linspace(0, count - 1, most).round())]


def _loaded(loads: Sequence[Callable]) -> Iterator:
    for load in loads:
        try:
            yield load()
        except AdaGMMError:
            continue
