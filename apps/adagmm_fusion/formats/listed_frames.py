"""Frames that a reader has found the files and the calibration of, as entries of a recording."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import checked_frame, read_color, read_depth
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.frames.one_grid import on_one_grid
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording, sequential_pairs
from adagmm_o3d.errors import InputError


@dataclass(frozen=True, eq=False)
class ListedFrame:
    """One frame's images and what is known of it; see `on_one_grid` for what the calibrations are of.

    color : a path, or what gives the (H, W, 3) RGB image.    depth : a path, or what gives the (H, W) depth image.
    where : the file that messages about the frame name.
    """

    name: str
    color: Path | Callable[[], np.ndarray]
    depth: Path | Callable[[], np.ndarray]
    intrinsics: PinholeIntrinsics | None
    depth_scale: float
    T_world_camera: np.ndarray | None = None
    timestamp: float | None = None
    depth_intrinsics: PinholeIntrinsics | None = None
    T_color_depth: np.ndarray | None = None
    where: Path | None = None


def recording_of_frames(
    folder: Path,
    format: str,
    sensor: str,
    frames: Sequence[ListedFrame],
    options: ReadOptions,
    notes: Sequence[str] = (),
) -> Recording:
    """The recording of one moving sensor. A rig replaces the intrinsics and the depth scale; with the two sensors
    `color` and `depth` it calibrates both cameras.

    Raises
    ------
    RecordingError  if there is no frame, or neither rig nor frame knows the intrinsics.    RigError  as ReadOptions.
    """
    if not frames:
        raise RecordingError(f"{folder}: there is no frame of colour and depth here")
    entries = []
    for frame in frames:
        calibration = _calibration(frame, sensor, options, folder)
        load = partial(load_listed_frame, frame, sensor, *calibration)
        file = frame.depth if isinstance(frame.depth, Path) else None
        entries.append(FrameEntry(frame.name, sensor, load, frame.T_world_camera, frame.timestamp, file))
    pairs = sequential_pairs(len(entries), options.step)
    name = folder.name if folder.is_dir() else folder.stem
    return Recording(name, folder, format, tuple(entries), pairs, notes=tuple(notes))


def load_listed_frame(
    frame: ListedFrame,
    sensor: str,
    intrinsics: PinholeIntrinsics,
    depth_scale: float,
    depth_intrinsics: PinholeIntrinsics | None,
    T_color_depth: np.ndarray | None,
) -> RGBDFrame:
    """Read both images and bring them onto one grid. Raises RecordingError naming a file."""
    color = read_color(frame.color) if isinstance(frame.color, Path) else frame.color()
    depth = read_depth(frame.depth) if isinstance(frame.depth, Path) else frame.depth()
    where = frame.where or (frame.depth if isinstance(frame.depth, Path) else Path(frame.name))
    try:
        grid = on_one_grid(color, depth, intrinsics, depth_scale, depth_intrinsics, T_color_depth)
    except InputError as problem:
        raise RecordingError(f"{where}: {problem}") from problem
    return checked_frame(where, frame.name, *grid, depth_scale, sensor, frame.timestamp)


def _calibration(
    frame: ListedFrame, sensor: str, options: ReadOptions, folder: Path
) -> tuple[PinholeIntrinsics, float, PinholeIntrinsics | None, np.ndarray | None]:
    rig = options.rig
    if rig is not None and {"color", "depth"} <= set(rig.sensors):
        depth = rig.sensor("depth")
        T = rig.T_target_source("color", "depth")
        return rig.sensor("color").intrinsics, depth.depth_scale, depth.intrinsics, T
    intrinsics, depth_scale = options.calibration(sensor, frame.intrinsics, frame.depth_scale, folder)
    if rig is not None:
        return intrinsics, depth_scale, None, None
    return intrinsics, depth_scale, frame.depth_intrinsics, frame.T_color_depth
