"""Our own layout: N sensors, fixed or on a moving rig. recordings/README.md describes it with an example.

recording.yaml              what there is, strictly read: unknown keys, aliases and the like are errors
<sensor>/color/<frame>.png  RGB, or .jpg, .jpeg
<sensor>/depth/<frame>.png  16 bit, in the rig file's depth units, 0 none, registered to the colour image; or .tiff,
                            .exr, .npy, .pgm, also of floating point numbers

recording.yaml keys
  format, version           adagmm-recording, 1
  name                      any text
  rig                       a rig file's name, sought here and then in ../../calibration
  motion                    fixed: the rig stands still. moving: T_world_rig says where it was
  sensors                   list of sensor names; the first one is the target
  frames                    optional list of {name, timestamps: {sensor: seconds}, T_world_rig: 4x4}, the last two
                            optional; without it every depth image of the first sensor is a frame
  pairs                     optional list of {source: sensor/frame, target: sensor/frame}; without it every frame
                            pairs each other sensor with the first one, or with one sensor each step-th frame with
                            the one before
"""

import re
from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.depth_files import DEPTH_SUFFIXES
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, inside, load_frame
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.files.strict_yaml import Item, read_yaml
from adagmm_fusion.formats.options import ReadOptions, listed_images
from adagmm_fusion.frames.rgbd import RGBDFrame, checked_rigid_transformation
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording, sequential_pairs
from adagmm_fusion.rigs.rig import SENSOR_NAME, Rig, SensorCalibration, load_rig
from adagmm_o3d.errors import InputError

NAME = "adagmm"
SUMMARY = "our own layout (recording.yaml, <sensor>/color/, <sensor>/depth/)"
MANIFEST = "recording.yaml"
FORMAT, VERSION = "adagmm-recording", 1
MAX_IMAGES = 1_000_000  # a small file can tell of many frames of many sensors
FRAME_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


def matches(folder: Path) -> bool:
    return is_given(folder / MANIFEST)


def read(folder: Path, options: ReadOptions) -> Recording:
    keys = read_yaml(folder / MANIFEST, RecordingError).mapping(
        required=("format", "version", "name", "rig", "motion", "sensors"), optional=("frames", "pairs")
    )
    keys["format"].literal(FORMAT)
    keys["version"].literal(str(VERSION))
    moving = _read_motion(keys["motion"])
    sensors = _read_sensors(keys["sensors"])
    rig = options.rig if options.rig is not None else load_rig(_find_rig(folder, keys["rig"]))
    calibrations = [rig.sensor(name) for name in sensors]
    notes: tuple[str, ...] = ()
    if "frames" in keys:
        frames = _read_frames(keys["frames"], sensors, moving)
    else:
        frames, notes = _find_frames(folder, sensors, moving)
    if len(frames) * len(calibrations) > MAX_IMAGES:
        raise RecordingError(f"{folder}: expected at most {MAX_IMAGES} frames of all sensors")
    entries = []
    for name, timestamps, T_world_rig in frames:
        for sensor in calibrations:
            T_world_sensor = None
            if T_world_rig is not None and sensor.T_rig_sensor is not None:
                T_world_sensor = T_world_rig @ sensor.T_rig_sensor
            load = partial(_load, folder, name, sensor, timestamps.get(sensor.name))
            file = folder / sensor.name / "depth" / f"{name}.png"  # or another, which is sought when it is loaded
            entries.append(FrameEntry(name, sensor.name, load, T_world_sensor, timestamps.get(sensor.name), file))
    if "pairs" in keys:
        pairs = _read_pairs(keys["pairs"], entries)
    else:
        pairs = _default_pairs(len(frames), len(sensors), options.step)
    pairs = tuple(_within_rig(pair, entries, rig) for pair in pairs)
    return Recording(keys["name"].text(), folder, NAME, tuple(entries), pairs, moving, notes)


def _load(folder: Path, frame: str, sensor: SensorCalibration, timestamp: float | None) -> RGBDFrame:
    where = str(folder)
    images = []
    for kind, suffixes in (("color", COLOR_SUFFIXES), ("depth", DEPTH_SUFFIXES)):
        paths = [inside(folder, f"{sensor.name}/{kind}/{frame}{suffix}", where) for suffix in suffixes]
        present = [path for path in paths if path.exists()]
        if len(present) > 1:
            raise RecordingError(f"{present[0]}: there is {present[1].name} beside it; keep one of them")
        images += present or paths[:1]
    color, depth = images
    return load_frame(frame, sensor.name, color, depth, sensor.intrinsics, sensor.depth_scale, timestamp)


def _read_motion(item: Item) -> bool:
    if item.text() not in ("fixed", "moving"):
        item.fail(f"expected fixed or moving, got {item.value}")
    return item.value == "moving"


def _read_sensors(item: Item) -> list[str]:
    names: dict[str, None] = {}
    for entry in item.sequence():
        name = entry.text()
        if not SENSOR_NAME.fullmatch(name):
            entry.fail(f"expected a name of letters, digits, _ - and . (not first), got {name!r}")
        if name in names:
            entry.fail(f"sensor {name!r} is listed twice")
        names[name] = None
    if not names:
        item.fail("expected at least one sensor, got none")
    return list(names)


def _find_rig(folder: Path, item: Item) -> Path:
    name = item.text()
    if not FRAME_NAME.fullmatch(name):
        item.fail(f"expected a file name without folders, got {name!r}")
    places = (folder / name, folder.resolve().parent.parent / "calibration" / name)
    for path in places:
        if is_given(path):
            return path
    item.fail(f"{name} is neither in the recording nor at {places[1]}; give the rig file")


def _read_frames(item: Item, sensors: list[str], moving: bool) -> list[tuple[str, dict, np.ndarray | None]]:
    frames, seen = [], set()
    for entry in item.sequence():
        keys = entry.mapping(required=("name",), optional=("timestamps", "T_world_rig"))
        name = keys["name"].text()
        if not FRAME_NAME.fullmatch(name):
            keys["name"].fail(f"expected a file name without folder and suffix, got {name!r}")
        if name in seen:
            keys["name"].fail(f"frame {name!r} is listed twice")
        seen.add(name)
        timestamps = {}
        if "timestamps" in keys:
            items = keys["timestamps"].mapping(optional=sensors)
            timestamps = {sensor: stamp.number() for sensor, stamp in items.items()}
        T_world_rig = None if moving else np.eye(4)
        if "T_world_rig" in keys:
            if not moving:
                keys["T_world_rig"].fail("motion is fixed, so the rig's frame is the world; say motion: moving")
            T_world_rig = _read_pose(keys["T_world_rig"])
        frames.append((name, timestamps, T_world_rig))
    return frames


def _read_pose(item: Item) -> np.ndarray:
    try:
        return checked_rigid_transformation(item.matrix(4, 4), "pose")
    except RecordingError:
        raise
    except InputError as problem:
        item.fail(str(problem))


def _find_frames(
    folder: Path, sensors: list[str], moving: bool
) -> tuple[list[tuple[str, dict, np.ndarray | None]], tuple[str, ...]]:
    """The frames that the first sensor has depth images of, and what to say of those that only other images are of."""
    first = f"{sensors[0]}/depth"
    depths = inside(folder, first, str(folder))
    if not depths.is_dir():
        raise RecordingError(f"{depths}: the folder of depth images is missing")
    names = [path.stem for path in listed_images(depths, DEPTH_SUFFIXES)]
    alone: set[str] = set()
    for kind, suffixes in (("color", COLOR_SUFFIXES), ("depth", DEPTH_SUFFIXES)):
        for sensor in sensors:
            images = inside(folder, f"{sensor}/{kind}", str(folder))
            if images.is_dir():
                alone.update(path.stem for path in listed_images(images, suffixes))
    alone -= set(names)
    more = f" and {len(alone) - 3} more" if len(alone) > 3 else ""
    note = f"left out, without their depth image of {sensors[0]}: {', '.join(sorted(alone)[:3])}{more}"
    return [(name, {}, None if moving else np.eye(4)) for name in names], (note,) if alone else ()


def _read_pairs(item: Item, entries: list[FrameEntry]) -> tuple[PairEntry, ...]:
    index = {f"{entry.sensor}/{entry.name}": i for i, entry in enumerate(entries)}
    pairs = []
    for entry in item.sequence():
        keys = entry.mapping(required=("source", "target"))
        for key in keys.values():
            if key.text() not in index:
                key.fail(f"expected sensor/frame of a frame that is there, got {key.value!r}")
        pairs.append(PairEntry(index[keys["source"].text()], index[keys["target"].text()]))
    return tuple(pairs)


def _within_rig(pair: PairEntry, entries: list[FrameEntry], rig: Rig) -> PairEntry:
    """With the rig's own answer where both frames are of one moment, wherever the rig was then."""
    source, target = entries[pair.source], entries[pair.target]
    if source.name != target.name or any(rig.sensors[e.sensor].T_rig_sensor is None for e in (source, target)):
        return pair
    return PairEntry(pair.source, pair.target, rig.T_target_source(target.sensor, source.sensor))


def _default_pairs(frame_count: int, sensor_count: int, step: int) -> tuple[PairEntry, ...]:
    if sensor_count == 1:
        return sequential_pairs(frame_count, step)
    first = range(0, frame_count * sensor_count, sensor_count)
    return tuple(PairEntry(i + other, i) for i in first for other in range(1, sensor_count))
