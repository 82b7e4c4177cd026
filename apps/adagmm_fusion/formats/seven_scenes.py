"""7-Scenes sequences: one moving Kinect v1 tracked by KinectFusion.

    frame-000000.color.png    RGB; or .jpg
    frame-000000.depth.png    16 bit, millimetres, 65535 and 0 none
    frame-000000.pose.txt     4x4 camera to world, metres; one of NaN or infinity where tracking was lost
    camera-intrinsics.txt     optional, 3x3, here or, as 3DMatch has it, above; or another file of intrinsics here

The folder is one sequence, such as chess/seq-01. Without intrinsics they are as the dataset says: 585 585 320 240. The
depth is the sensor's own and not registered to the colour; the dataset gives no calibration between the two, so they
are taken as one grid (colours are a few pixels off). Source: Shotton et al. 2013 and the dataset's page; Zeng et al.
2017 (3DMatch).
"""

from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, inside, load_frame
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.formats.own_camera import calibration_with_own
from adagmm_fusion.formats.text_table import parse_pose, read_rows
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording, sequential_pairs

NAME = "7scenes"
SUMMARY = "7-Scenes sequence (frame-000000.color.png, .depth.png, .pose.txt)"
SENSOR = "kinect"
DEPTH_SCALE = 1000.0
OF_ALL_SEQUENCES = "camera-intrinsics.txt"
INTRINSICS = PinholeIntrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)


def matches(folder: Path) -> bool:
    return any(folder.glob("frame-*.pose.txt"))


def read(folder: Path, options: ReadOptions) -> Recording:
    poses = sorted(folder.glob("frame-*.pose.txt"))
    if not poses:
        raise RecordingError(f"{folder}: no frame-*.pose.txt here; name one sequence, such as seq-01")
    depths = (inside(folder, path.name.replace(".pose.txt", ".depth.png"), str(folder)) for path in poses)
    intrinsics, depth_scale, notes = calibration_with_own(
        folder, options, SENSOR, INTRINSICS, DEPTH_SCALE, depths, beside=folder.resolve().parent / OF_ALL_SEQUENCES
    )
    entries = []
    for path in poses:
        name = path.name.removesuffix(".pose.txt")
        colors = [inside(folder, f"{name}.color{suffix}", str(folder)) for suffix in COLOR_SUFFIXES]
        color = next((path for path in colors if path.exists()), colors[0])
        depth = inside(folder, f"{name}.depth.png", str(folder))
        load = partial(load_frame, name, SENSOR, color, depth, intrinsics, depth_scale, fix_depth=_without_invalid)
        entries.append(FrameEntry(name, SENSOR, load, _read_pose(path), depth_file=depth))
    pairs = sequential_pairs(len(entries), options.step)
    return Recording(folder.name, folder, NAME, tuple(entries), pairs, notes=notes)


def _without_invalid(depth: np.ndarray) -> np.ndarray:
    return np.where(depth == np.iinfo(np.uint16).max, 0, depth).astype(np.uint16)


def _read_pose(path: Path) -> np.ndarray | None:
    words = [word for _, line in read_rows(path) for word in line]
    try:
        numbers = np.array(words, dtype=np.float64)
    except ValueError:
        raise RecordingError(f"{path}: expected 16 numbers, got {' '.join(words)[:80]!r}") from None
    if numbers.size != 16:
        raise RecordingError(f"{path}: expected 16 numbers, got {numbers.size}")
    return parse_pose(numbers, str(path)) if np.isfinite(numbers).all() else None
