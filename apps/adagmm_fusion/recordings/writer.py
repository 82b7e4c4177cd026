"""Any recording, written in our own layout: images without loss, the rig, timestamps, poses and pairs."""

import json
import os
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from adagmm_fusion.errors import OutputError, RecordingError
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.files.output_folder import check_new_folder, exclusive
from adagmm_fusion.formats.own import FORMAT, FRAME_NAME, MANIFEST, VERSION
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig
from adagmm_o3d.lie import se_inverse

RIG_FILE = "rig.yaml"
# Depth that is not stored as whole units already is stored in millimetres.
MILLIMETRES_PER_METRE = 1000.0


def with_plain_names(recording: Recording) -> Recording:
    """The recording with frames whose names our layout takes, and a note where some were others: Büro 1 is B_ro_1."""
    renamed: dict[str, str] = {}
    taken = {entry.name for entry in recording.entries}
    for entry in recording.entries:
        if FRAME_NAME.fullmatch(entry.name) or entry.name in renamed:
            continue
        plain = re.sub(r"[^A-Za-z0-9_.-]", "_", entry.name)
        plain = plain if FRAME_NAME.fullmatch(plain) else f"_{plain}"
        while plain in taken:
            plain += "_"
        renamed[entry.name] = plain
        taken.add(plain)
    if not renamed:
        return recording
    entries = tuple(replace(entry, name=renamed.get(entry.name, entry.name)) for entry in recording.entries)
    name, plain = next(iter(renamed.items()))
    note = f"{len(renamed)} frames have other names, such as {plain} for {name}"
    return replace(recording, entries=entries, notes=(*recording.notes, note))


def convert_recording(
    recording: Recording, folder: str | Path, *, on_frame: Callable[[int, int], None] | None = None
) -> Path:
    """Write `recording` to `folder` in our own layout, its rig beside it as rig.yaml.

    The frames are read and written one by one. Depth stays as it is where it is 16 bits; other depth is rounded, to its
    own units if these are finer than a millimetre, else to millimetres; what is farther than 16 bits reach is refused.

    Parameters
    ----------
    folder : must not exist, or be empty; it appears under its name when it is complete.
    on_frame : called with the number of images of a sensor written so far, and of all.

    Returns
    -------
    The path of recording.yaml.

    Raises
    ------
    RecordingError  if a frame cannot be read, or the recording does not fit the layout: a sensor that changes its
        intrinsics, a moment that not all sensors saw, sensors that move against each other, depth that 16 bits do not
        hold.
    OutputError  if the folder cannot be written, or holds something.
    """
    folder = Path(folder)
    check_new_folder(folder)
    moments = _moments(recording)
    extrinsics, moving = _extrinsics(recording, moments)
    partial = folder.with_name(f".{folder.name}.partial")
    with exclusive(partial, follow_links=False):  # what lies in it is taken away
        try:
            for left in partial.iterdir():  # by a run that was killed
                shutil.rmtree(left) if left.is_dir() else left.unlink()
            calibrations = _write_images(recording, partial, on_frame)
            sensors = {
                name: SensorCalibration(name, *calibrations[name], T_rig_sensor=extrinsics[name])
                for name in recording.sensors
            }
            description = f"of {recording.path.name}, read as {recording.format}"
            save_rig(partial / RIG_FILE, Rig(recording.name, sensors, description))
            write_text(partial / MANIFEST, _manifest(recording, moments, moving))
            os.replace(partial, folder)
        except OSError as problem:
            if isinstance(problem, OutputError):
                raise
            raise OutputError(f"{folder}: cannot be written: {problem.strerror or problem}") from problem
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    return folder / MANIFEST


def _moments(recording: Recording) -> dict[str, dict[str, FrameEntry]]:
    """Entries by frame name and sensor; every sensor saw every moment."""
    moments: dict[str, dict[str, FrameEntry]] = {}
    for entry in recording.entries:
        if not FRAME_NAME.fullmatch(entry.name):
            raise RecordingError(
                f"{recording.path}: frame {entry.name!r} has a name that is no plain file name; see with_plain_names"
            )
        if entry.sensor in moments.setdefault(entry.name, {}):
            raise RecordingError(f"{recording.path}: {entry.sensor} has two frames {entry.name}")
        moments[entry.name][entry.sensor] = entry
    for name, entries in moments.items():
        if missing := [sensor for sensor in recording.sensors if sensor not in entries]:
            raise RecordingError(f"{recording.path}: frame {name} was not seen by {', '.join(missing)}")
    return moments


def _extrinsics(
    recording: Recording, moments: Mapping[Any, dict[str, FrameEntry]]
) -> tuple[dict[str, np.ndarray | None], bool]:
    """T_rig_sensor of each sensor, and whether the rig moves; a moving rig's frame is its first sensor's."""
    first, *others = recording.sensors
    moving = not others or any(_differ(e, moments) for e in next(iter(moments.values())).values())
    if not moving:
        return {sensor: entry.T_world_camera for sensor, entry in next(iter(moments.values())).items()}, False
    extrinsics: dict[str, np.ndarray | None] = {first: np.eye(4)} | dict.fromkeys(others)
    for pair in recording.pairs:
        source, target = recording.entries[pair.source], recording.entries[pair.target]
        if pair.T_target_source is not None and source.name == target.name and target.sensor == first:
            extrinsics[source.sensor] = pair.T_target_source
    for sensor in others:
        for name, entries in moments.items():
            T_world_first, T_world_sensor = entries[first].T_world_camera, entries[sensor].T_world_camera
            if T_world_first is None or T_world_sensor is None:
                continue
            relative = se_inverse(T_world_first) @ T_world_sensor
            known = extrinsics[sensor]
            if known is None:
                extrinsics[sensor] = relative
            elif not np.allclose(relative, known, rtol=0, atol=1e-6):
                raise RecordingError(f"{recording.path}: {sensor} has moved against {first} in frame {name}")
    return extrinsics, True


def _differ(entry: FrameEntry, moments: Mapping[Any, dict[str, FrameEntry]]) -> bool:
    poses = [entries[entry.sensor].T_world_camera for entries in moments.values()]
    if any(pose is None for pose in poses):
        return any(pose is not None for pose in poses)
    return any(not np.array_equal(pose, poses[0]) for pose in poses)


def _write_images(
    recording: Recording, folder: Path, on_frame: Callable[[int, int], None] | None
) -> dict[str, tuple[PinholeIntrinsics, float]]:
    """Write all images; returns the intrinsics and depth scale of each sensor."""
    calibrations: dict[str, tuple[PinholeIntrinsics, float]] = {}
    for number, entry in enumerate(recording.entries, 1):
        frame = entry.load()
        depth, depth_scale = _whole_units(frame, recording.path)
        known = calibrations.setdefault(entry.sensor, (frame.intrinsics, depth_scale))
        if known != (frame.intrinsics, depth_scale):
            raise RecordingError(
                f"{recording.path}: {entry.sensor} changes its intrinsics or depth scale in {entry.name}"
            )
        for kind, image in (("color", frame.color[:, :, ::-1]), ("depth", depth)):
            path = folder / entry.sensor / kind / f"{entry.name}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            _, data = cv2.imencode(".png", image)
            path.write_bytes(data.tobytes())
        if on_frame is not None:
            on_frame(number, len(recording.entries))
    return calibrations


def _whole_units(frame: RGBDFrame, path: Path) -> tuple[np.ndarray, float]:
    if frame.depth.dtype == np.uint16:
        return frame.depth, frame.depth_scale
    depth_scale = max(frame.depth_scale, MILLIMETRES_PER_METRE)
    units = np.rint(np.nan_to_num(frame.depth_m().astype(np.float64)) * depth_scale)
    most = np.iinfo(np.uint16).max
    if units.max() > most:
        raise RecordingError(
            f"{path}: {frame.sensor}: frame {frame.name}: expected depth up to {most / depth_scale:g} m, which 16 bits "
            f"hold in units of 1/{depth_scale:g} m, got {units.max() / depth_scale:g} m; set what is farther to 0 there"
        )
    return units.astype(np.uint16), depth_scale


def _manifest(recording: Recording, moments: Mapping[Any, dict[str, FrameEntry]], moving: bool) -> str:
    def quoted(text):
        return json.dumps(text, ensure_ascii=False)

    lines = [f"format: {FORMAT}", f"version: {VERSION}", f"name: {quoted(recording.name)}", f"rig: {RIG_FILE}"]
    lines += [f"motion: {'moving' if moving else 'fixed'}"]
    lines += [f"sensors: [{', '.join(map(quoted, recording.sensors))}]", "frames:"]
    for name, entries in moments.items():
        lines.append(f"  - name: {quoted(name)}")
        stamps = [f"{quoted(s)}: {e.timestamp!r}" for s, e in entries.items() if e.timestamp is not None]
        if stamps:
            lines.append(f"    timestamps: {{{', '.join(stamps)}}}")
        pose = entries[recording.sensors[0]].T_world_camera
        if moving and pose is not None:
            lines.append("    T_world_rig:")
            lines += [f"      - [{', '.join(repr(float(x)) for x in row)}]" for row in pose]
    lines.append("pairs:")
    for pair in recording.pairs:
        ends = (recording.entries[pair.source], recording.entries[pair.target])
        source, target = (quoted(f"{entry.sensor}/{entry.name}") for entry in ends)
        lines.append(f"  - {{source: {source}, target: {target}}}")
    return "\n".join(lines) + "\n"
