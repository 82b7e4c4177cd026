"""Redwood and Open3D folders: one moving sensor and a .log trajectory.

    color/ (or image/, rgb/)    *.jpg or *.png, RGB
    depth/                      *.png, 16 bit, millimetres, 0 none, registered to the colour image
    trajectory.log              or the only other *.log; per frame a line of three integers, of which the first is the
                                frame's index, and four lines of four numbers, T_world_camera in metres
    camera_intrinsic.json       or intrinsic.json, optional, Open3D's PinholeCameraIntrinsic; else PrimeSense 525 525
                                319.5 239.5, 640x480

Colour and depth belong together by the number that their names start with (Redwood adds a time stamp after a dash,
which differs); what has no partner is left out. Without a .log there is no ground truth. Source: Choi, Zhou, Koltun
2015; Open3D's reconstruction system.
"""

import json
import math
from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.depth_files import DEPTH_SUFFIXES
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, inside, load_frame
from adagmm_fusion.files.input_file import is_given, read_input_text
from adagmm_fusion.formats.options import PRIMESENSE, ReadOptions, intrinsics_from_matrix, listed_images, unpaired_notes
from adagmm_fusion.formats.text_table import parse_numbers, parse_pose, read_rows
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording, sequential_pairs

NAME = "redwood"
SUMMARY = "Redwood/Open3D folder (color/, depth/, trajectory.log)"
SENSOR = "camera"
DEPTH_SCALE = 1000.0
COLOR_FOLDERS = ("color", "image", "rgb")
INTRINSICS_NAMES = ("camera_intrinsic.json", "intrinsic.json")


def matches(folder: Path) -> bool:
    has_images = (folder / "depth").is_dir() and any((folder / name).is_dir() for name in COLOR_FOLDERS)
    return has_images and (any(folder.glob("*.log")) or _intrinsics_path(folder) is not None)


def read(folder: Path, options: ReadOptions) -> Recording:
    color_folder = next((folder / name for name in COLOR_FOLDERS if (folder / name).is_dir()), None)
    if color_folder is None or not (folder / "depth").is_dir():
        raise RecordingError(f"{folder}: expected the folders color/ and depth/")
    colors = {path.stem.split("-")[0]: path for path in listed_images(color_folder, COLOR_SUFFIXES)}
    depths = {path.stem.split("-")[0]: path for path in listed_images(folder / "depth", DEPTH_SUFFIXES)}
    notes = unpaired_notes(colors, depths, folder)
    # The trajectory counts all frames, those without a partner included.
    names = sorted(colors.keys() | depths.keys())
    poses = _read_trajectory(folder, len(names))
    intrinsics, depth_scale = options.calibration(SENSOR, _read_intrinsics(folder), DEPTH_SCALE, folder)
    entries = []
    for i, name in enumerate(names):
        if name not in colors or name not in depths:
            continue
        color, depth = (inside(folder, str(p.relative_to(folder)), str(folder)) for p in (colors[name], depths[name]))
        load = partial(load_frame, name, SENSOR, color, depth, intrinsics, depth_scale)
        entries.append(FrameEntry(name, SENSOR, load, poses.get(i)))
    pairs = sequential_pairs(len(entries), options.step)
    return Recording(folder.name, folder, NAME, tuple(entries), pairs, notes=notes)


def _read_trajectory(folder: Path, frame_count: int) -> dict[int, np.ndarray]:
    """T_world_camera by frame index."""
    logs = sorted(folder.glob("*.log"))
    if folder / "trajectory.log" in logs:
        logs = [folder / "trajectory.log"]
    if not logs:
        return {}
    if len(logs) > 1:
        names = ", ".join(path.name for path in logs)
        raise RecordingError(f"{folder}: several trajectories ({names}); name the one to use trajectory.log")
    rows = list(read_rows(logs[0]))
    if len(rows) % 5:
        raise RecordingError(f"{logs[0]}: expected five lines a frame, got {len(rows)} lines in all")
    poses = {}
    for start in range(0, len(rows), 5):
        where, words = rows[start]
        index = parse_numbers(words, 3, where)[0]
        if not (index.is_integer() and 0 <= index < frame_count):
            raise RecordingError(f"{where}: expected a frame index from 0 to {frame_count - 1}, got {words[0]}")
        if index in poses:
            raise RecordingError(f"{where}: frame {words[0]} has a pose already")
        numbers = [parse_numbers(words, 4, where) for where, words in rows[start + 1 : start + 5]]
        poses[int(index)] = parse_pose(numbers, where)
    return poses


def _intrinsics_path(folder: Path) -> Path | None:
    return next((folder / name for name in INTRINSICS_NAMES if is_given(folder / name)), None)


def _read_intrinsics(folder: Path) -> PinholeIntrinsics:
    path = _intrinsics_path(folder)
    if path is None:
        return PRIMESENSE
    text = read_input_text(path, RecordingError)
    try:
        values = json.loads(text)
        width, height, columns = values["width"], values["height"], values["intrinsic_matrix"]
        K = np.array(columns, dtype=np.float64).reshape(3, 3).T  # column by column, as Open3D writes it
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as problem:
        raise RecordingError(
            f"{path}: expected width, height and intrinsic_matrix (9 numbers): {problem!r}"
        ) from problem
    if not all(math.isfinite(x) for x in K.flat):
        raise RecordingError(f"{path}: intrinsic_matrix: expected finite numbers")
    return intrinsics_from_matrix(K, (width, height), path)
