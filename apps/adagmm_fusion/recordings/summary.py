"""What a recording holds: its sensors as their frames show them, and its pairs."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.processes.terminal import printable
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_inverse

# A step that is so much longer than the median one is a gap.
LONG_STEP = 2.5


@dataclass
class SensorSummary:
    """One sensor's frames; every list has the distinct values in the order of their appearance.

    median_depths_m : (frames with depth,) the median of each.    missing_depth : share of all pixels, NaN without any.
    """

    name: str
    frames: int = 0
    unreadable: int = 0
    intrinsics: list[PinholeIntrinsics] = field(default_factory=list)
    depth_scales: list[float] = field(default_factory=list)
    depth_dtypes: list[str] = field(default_factory=list)
    median_depths_m: list[float] = field(default_factory=list)
    pixels: int = 0
    pixels_without_depth: int = 0
    timestamps: list[float] = field(default_factory=list)
    poses: int = 0

    @property
    def missing_depth(self) -> float:
        return self.pixels_without_depth / self.pixels if self.pixels else float("nan")


@dataclass(frozen=True, eq=False)
class RecordingSummary:
    """`summarize_recording`'s answer.

    time_offsets_s : source minus target, of the pairs whose frames both know their time.
    true_rotations_deg, true_translations_m : how far apart the frames of a pair are, of those with ground truth.
    problems : one line for each frame that cannot be read.
    """

    recording: Recording
    sensors: dict[str, SensorSummary]
    time_offsets_s: list[float]
    true_rotations_deg: list[float]
    true_translations_m: list[float]
    problems: list[str]


def summarize_recording(
    recording: Recording, *, on_frame: Callable[[int, int], None] | None = None
) -> RecordingSummary:
    """Load every frame once, one at a time. `on_frame` is called with the number of frames done, and of all."""
    sensors = {name: SensorSummary(name) for name in recording.sensors}
    timestamps: list[float | None] = []
    problems = []
    for number, entry in enumerate(recording.entries, 1):
        sensor = sensors[entry.sensor]
        stamp = entry.timestamp
        try:
            stamp = _add_frame(sensor, entry)
        except AdaGMMError as problem:
            sensor.unreadable += 1
            problems.append(str(problem))
        timestamps.append(stamp)
        sensor.timestamps += [] if stamp is None else [stamp]
        if on_frame is not None:
            on_frame(number, len(recording.entries))
    offsets, rotations, translations = [], [], []
    for pair in recording.pairs:
        source, target = recording.entries[pair.source], recording.entries[pair.target]
        times = timestamps[pair.source], timestamps[pair.target]
        if None not in times:
            offsets.append(times[0] - times[1])
        T = pair.T_target_source
        if T is None and source.T_world_camera is not None and target.T_world_camera is not None:
            T = se_inverse(target.T_world_camera) @ source.T_world_camera
        if T is not None:
            apart = pose_errors(np.eye(4), T)
            rotations.append(apart.rotation_deg)
            translations.append(apart.translation)
    return RecordingSummary(recording, sensors, offsets, rotations, translations, problems)


def summary_tables(summary: RecordingSummary) -> tuple[Table, Table]:
    """The recording and its pairs; its sensors, a column each."""
    recording = summary.recording
    general = _table("recording", printable(recording.path))
    for label, value in (
        ("name", recording.name),
        ("format", recording.format),
        ("sensors", ", ".join(recording.sensors)),
        ("frames", str(len(recording.entries))),
        ("pairs", str(len(recording))),
        ("time between the frames of a pair", _time_range(summary.time_offsets_s) or "not known"),
        ("ground truth", _ground_truth(summary)),
    ):
        general.add_row(label, Text(value))
    sensors = _table("sensor", *summary.sensors)
    columns = [_sensor_column(sensor) for sensor in summary.sensors.values()]
    for label in columns[0]:
        sensors.add_row(label, *(Text(column[label]) for column in columns))
    return general, sensors


def _add_frame(sensor: SensorSummary, entry: FrameEntry) -> float | None:
    """Take a frame into account; its time [s], or None."""
    sensor.frames += 1
    sensor.poses += entry.T_world_camera is not None
    frame = entry.load()
    seen: tuple[tuple[list, Any], ...] = (
        (sensor.intrinsics, frame.intrinsics),
        (sensor.depth_scales, frame.depth_scale),
        (sensor.depth_dtypes, str(frame.depth.dtype)),
    )
    for values, value in seen:
        if value not in values:
            values.append(value)
    depth = frame.depth_m()
    measured = depth[np.isfinite(depth)]
    sensor.pixels += depth.size
    sensor.pixels_without_depth += depth.size - measured.size
    if measured.size:
        sensor.median_depths_m.append(float(np.median(measured)))
    return frame.timestamp if entry.timestamp is None else entry.timestamp


def _table(*headings: str) -> Table:
    table = Table()
    for heading in headings:
        table.add_column(Text(heading), overflow="fold")
    return table


def _sensor_column(sensor: SensorSummary) -> dict[str, str]:
    def each(values: Iterable[Any], text: Callable[[Any], str]) -> str:
        return "; ".join(map(text, values)) or "not known"

    return {
        "frames": f"{sensor.frames}" + (f", {sensor.unreadable} unreadable" if sensor.unreadable else ""),
        "image size": each(dict.fromkeys((k.width, k.height) for k in sensor.intrinsics), lambda s: f"{s[0]} x {s[1]}"),
        "focal length fx, fy": each(sensor.intrinsics, lambda k: f"{k.fx:.6g}, {k.fy:.6g} px"),
        "principal point cx, cy": each(sensor.intrinsics, lambda k: f"{k.cx:.6g}, {k.cy:.6g} px"),
        "distortion": each(
            sensor.intrinsics, lambda k: ", ".join(f"{c:.4g}" for c in k.distortion) if k.distorted else "none"
        ),
        "depth": each(sensor.depth_dtypes, str),
        "depth scale": each(sensor.depth_scales, lambda scale: f"{scale:g} per metre"),
        "median depth of a frame": _range(sensor.median_depths_m, 1.0, "m") or "no depth",
        "missing depth": f"{100.0 * sensor.missing_depth:.1f} %" if sensor.pixels else "not known",
        "time": _duration(sensor.timestamps),
        "time from frame to frame": _steps(sensor.timestamps),
        "frames with true pose": str(sensor.poses),
    }


def _range(values: list[float], scale: float, unit: str) -> str:
    if not values:
        return ""
    low, middle, high = (scale * x for x in (min(values), float(np.median(values)), max(values)))
    if f"{low:.4g}" == f"{high:.4g}":
        return f"{middle:.4g} {unit}"
    return f"{middle:.4g} {unit}, from {low:.4g} to {high:.4g}"


def _time_range(seconds: list[float]) -> str:
    short = all(abs(second) < 1.0 for second in seconds)
    return _range(seconds, 1000.0, "ms") if short else _range(seconds, 1.0, "s")


def _duration(stamps: list[float]) -> str:
    return f"{max(stamps) - min(stamps):.4g} s" if stamps else "not known"


def _steps(stamps: list[float]) -> str:
    """How the times go on, and where they do not: a pause, frames that are missing, a clock that was set."""
    steps = np.diff(stamps)
    if not len(steps):
        return "not known"
    backwards, usual = steps[steps <= 0], np.median(steps)
    gaps = steps[steps > LONG_STEP * usual] if usual > 0 else steps[:0]
    parts = [_time_range(list(steps))]
    if len(gaps):
        parts.append(f"pauses or jumps of the clock: {len(gaps)}, the longest {max(gaps):.4g} s")
    if len(backwards):
        parts.append(f"clock stands still or is set back: {len(backwards)}, by up to {-min(backwards):.4g} s")
    return "; ".join(parts)


def _ground_truth(summary: RecordingSummary) -> str:
    count = len(summary.true_rotations_deg)
    if not count:
        return "not known"
    known = "known" if count == len(summary.recording) else f"known of {count} pairs"
    rotation, translation = _range(summary.true_rotations_deg, 1.0, "°"), _range(summary.true_translations_m, 1.0, "m")
    return f"{known}; apart by {rotation}; {translation}"
