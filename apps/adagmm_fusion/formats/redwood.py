"""Redwood and Open3D folders: one moving sensor and a .log trajectory.

    color/ (or image/, rgb/)    *.jpg or *.png, RGB
    depth/                      *.png, 16 bit, millimetres, 0 none, registered to the colour image
    trajectory.log              or the only other *.log of such lines; per frame a line of three integers, of which the
                                first is the frame's index, and four lines of four numbers, T_world_camera in metres
    camera_intrinsic.json       or intrinsic.json, optional, Open3D's PinholeCameraIntrinsic: width, height and
                                intrinsic_matrix, nine numbers column by column; a depth_scale and a lens distortion
                                beside them count. Else PrimeSense 525 525 319.5 239.5, 640x480

Colour and depth belong together by equal names, or by the number that their names start with (Redwood adds a time stamp
after a dash, which differs); what has no partner is left out. Without a .log there is no ground truth. A folder with
another file about cameras, or whose names do not pair so, is left to the format `folder`. Source: Choi, Zhou, Koltun
2015; Open3D's reconstruction system.
"""

import re
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.depth_files import DEPTH_SUFFIXES
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, image_size, inside
from adagmm_fusion.files.input_file import is_given, visible
from adagmm_fusion.files.json_file import read_json
from adagmm_fusion.formats.camera_files import find_camera_files, read_camera_file
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import PRIMESENSE, ReadOptions, listed_images, unpaired_notes
from adagmm_fusion.formats.text_table import parse_numbers, parse_pose, read_rows
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import Recording

NAME = "redwood"
SUMMARY = "Redwood/Open3D folder (color/, depth/, trajectory.log)"
SENSOR = "camera"
DEPTH_SCALE = 1000.0
COLOR_FOLDERS = ("color", "image", "rgb")
TRAJECTORY = "trajectory.log"
INTRINSICS_NAMES = ("camera_intrinsic.json", "intrinsic.json")


def matches(folder: Path) -> bool:
    color_folder = _color_folder(folder)
    if color_folder is None or not (folder / "depth").is_dir():
        return False
    path = _intrinsics_path(folder)
    is_open3d = _trajectories(folder) if path is None else _is_open3d(path)
    # Whatever else speaks of the camera would be passed over.
    return bool(is_open3d) and set(_camera_files(folder)) <= {path} and _keyed(color_folder, folder) is not None


def read(folder: Path, options: ReadOptions) -> Recording:
    color_folder = _color_folder(folder)
    if color_folder is None or not (folder / "depth").is_dir():
        raise RecordingError(f"{folder}: expected the folders color/ and depth/")
    keyed = _keyed(color_folder, folder)
    if keyed is None:
        raise RecordingError(
            f"{folder}: expected images of equal names, or that start with the frame's number and a dash, in "
            f"{color_folder.name}/ and as *.png in depth/; rename them, or read it as the format folder"
        )
    colors, depths = keyed
    notes = list(unpaired_notes(colors, depths, folder))
    # The trajectory counts all frames, those without a partner included.
    names = sorted(colors.keys() | depths.keys(), key=_by_number)
    poses = _read_trajectory(folder, len(names), notes)
    images = {
        name: tuple(inside(folder, str(p[name].relative_to(folder)), str(folder)) for p in (colors, depths))
        for name in names
        if name in colors and name in depths
    }
    intrinsics, depth_scale = _read_intrinsics(folder, next(iter(images.values()))[1], options, notes)
    frames = [
        ListedFrame(name, images[name][0], images[name][1], intrinsics, depth_scale, poses.get(i))
        for i, name in enumerate(names)
        if name in images
    ]
    return recording_of_frames(folder, NAME, SENSOR, frames, options, notes)


def takes_primesense(folder: Path, size: tuple[int, int]) -> bool:
    """Whether `read` would go by PrimeSense's intrinsics for a folder whose depth images are (width, height)."""
    color_folder = _color_folder(folder)
    if color_folder is None or not (folder / "depth").is_dir() or _intrinsics_path(folder) is not None:
        return False
    return size == (PRIMESENSE.width, PRIMESENSE.height) and _keyed(color_folder, folder) is not None


def _color_folder(folder: Path) -> Path | None:
    return next((folder / name for name in COLOR_FOLDERS if (folder / name).is_dir()), None)


def _keyed(color_folder: Path, folder: Path) -> tuple[dict[str, Path], dict[str, Path]] | None:
    """The colour and the depth images by what they have in common with their partners; None if that is nothing, or is
    common to several."""
    colors, depths = listed_images(color_folder, COLOR_SUFFIXES), listed_images(folder / "depth", DEPTH_SUFFIXES)
    found = []
    if any(path.suffix.lower() != ".png" for path in depths):  # these may be of metres
        return None
    for key in (lambda path: path.stem, lambda path: path.stem.split("-")[0]):
        by_key = {key(path): path for path in colors}, {key(path): path for path in depths}
        if len(by_key[0]) == len(colors) and len(by_key[1]) == len(depths) and by_key[0].keys() & by_key[1].keys():
            found.append(by_key)
    return max(found, key=lambda by_key: len(by_key[0].keys() & by_key[1].keys()), default=None)


def _by_number(name: str) -> list[tuple[int, str]]:
    """Frame 10 after frame 9, whether or not the names have leading zeros, as Open3D sorts them."""
    return [(int(word[:18]), word) if word.isdecimal() else (-1, word) for word in re.split(r"(\d+)", name)]


def _read_trajectory(folder: Path, frame_count: int, notes: list[str]) -> dict[int, np.ndarray]:
    """T_world_camera by frame index."""
    logs = _trajectories(folder)
    if not logs:
        notes += [
            f"{path.name}: left out, it is no trajectory; expected lines of three integers and of four numbers"
            for path in visible(folder.glob("*.log"))
        ]
        return {}
    if len(logs) > 1:
        names = ", ".join(path.name for path in logs)
        raise RecordingError(f"{folder}: several trajectories ({names}); name the one to use {TRAJECTORY}")
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
    if len(poses) < frame_count:
        notes.append(
            f"{logs[0].name}: {frame_count - len(poses)} of {frame_count} frames have no pose in it; pairs with them "
            "have no ground truth"
        )
    return poses


def _trajectories(folder: Path) -> list[Path]:
    """trajectory.log, whose mistakes are said; else what starts like one, for programs write logs too."""
    if is_given(folder / TRAJECTORY):
        return [folder / TRAJECTORY]
    return [path for path in visible(folder.glob("*.log")) if _starts_like_a_trajectory(path)]


def _starts_like_a_trajectory(path: Path) -> bool:
    try:
        rows = list(islice(read_rows(path), 2))
        return len(rows) == 2 and bool(parse_numbers(rows[0][1], 3, "") and parse_numbers(rows[1][1], 4, ""))
    except RecordingError:
        return False


def _intrinsics_path(folder: Path) -> Path | None:
    return next((folder / name for name in INTRINSICS_NAMES if is_given(folder / name)), None)


def _is_open3d(path: Path) -> bool:
    """Whether it is of one camera, as Open3D writes it: the matrix column by column."""
    try:
        values = read_json(path)
    except RecordingError:
        return False
    if not isinstance(values, dict) or any(isinstance(value, dict) for value in values.values()):
        return False
    columns = values.get("intrinsic_matrix")
    flat = isinstance(columns, list) and len(columns) == 9 and not any(isinstance(x, list) for x in columns)
    return flat and columns[2] == columns[5] == 0 and "width" in values and "height" in values


def _camera_files(folder: Path) -> Iterable[Path]:
    try:
        return find_camera_files(folder)
    except (RecordingError, OSError):  # a link that leads out, a closed folder: the format `folder` says so
        return [folder]


def _read_intrinsics(
    folder: Path, depth: Path, options: ReadOptions, notes: list[str]
) -> tuple[PinholeIntrinsics | None, float]:
    """The intrinsics, None if only a rig can say them, and the depth units per metre."""
    path = _intrinsics_path(folder)
    if path is not None:
        camera = read_camera_file(path)
        if camera is None:
            raise RecordingError(f"{path}: expected width, height and intrinsic_matrix (9 numbers)")
        sizes = (camera.size or image_size(depth),)
        if (doubt := camera.doubt(sizes)) is not None:
            notes.append(doubt)
        return camera.intrinsics(sizes), camera.depth_scale or DEPTH_SCALE
    k = PRIMESENSE
    if options.rig is not None:
        return None, DEPTH_SCALE
    width, height = image_size(depth)
    if (width, height) != (k.width, k.height):
        raise RecordingError(
            f"{folder}: expected {INTRINSICS_NAMES[0]}, as images of {width}x{height} pixels are not PrimeSense's of "
            f"{k.width}x{k.height}; add it, or give a rig file"
        )
    notes.append(
        f"the intrinsics are taken for PrimeSense's {k.fx:g} {k.fy:g} {k.cx:g} {k.cy:g}, no {INTRINSICS_NAMES[0]} says"
    )
    return k, DEPTH_SCALE
