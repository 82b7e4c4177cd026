"""Scenes of the Amazon Picking Challenge toolbox: one RealSense F200 on a robot arm.

    frame-000000.color.png    RGB
    frame-000000.depth.png    16 bit, registered to the colour image, its bits rotated: z = (stored << 13 | stored >>
                              3) mod 2^16, in units of 0.1 mm, 0 none
    cam.info.txt              headings "# ..." with the rows of a matrix below each; those read here are
                              "Color camera intrinsic matrix" (3x3) and, for each frame,
                              "Camera-to-world extrinsic matrix (camera pose) for frame-000000" (4x4, metres)

A frame without a pose has no ground truth. Source: Zeng et al., apc-vision-toolbox.
"""

import re
from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import image_size, inside, load_frame
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.formats.options import ReadOptions, intrinsics_from_matrix
from adagmm_fusion.formats.text_table import parse_numbers, parse_pose, read_lines
from adagmm_fusion.recordings.frame_sequence import FrameEntry, Recording, sequential_pairs

NAME = "apc"
SUMMARY = "Amazon Picking Challenge scene (cam.info.txt, frame-000000.color.png, .depth.png)"
SENSOR = "camera"
DEPTH_SCALE = 10000.0
POSE_HEADING = re.compile(r"Camera-to-world extrinsic matrix .*for (frame-\d+)")


def matches(folder: Path) -> bool:
    return is_given(folder / "cam.info.txt")


def read(folder: Path, options: ReadOptions) -> Recording:
    info = folder / "cam.info.txt"
    K, poses = _read_info(info)
    depths = sorted(folder.glob("frame-*.depth.png"))
    if not depths:
        raise RecordingError(f"{folder}: no frame-*.depth.png here")
    own = intrinsics_from_matrix(K, image_size(depths[0]), info)
    intrinsics, depth_scale = options.calibration(SENSOR, own, DEPTH_SCALE, folder)
    entries = []
    for path in depths:
        name = path.name.removesuffix(".depth.png")
        color, depth = (inside(folder, f"{name}.{kind}.png", str(folder)) for kind in ("color", "depth"))
        load = partial(load_frame, name, SENSOR, color, depth, intrinsics, depth_scale, fix_depth=_rotate_bits_back)
        entries.append(FrameEntry(name, SENSOR, load, poses.get(name), depth_file=depth))
    return Recording(folder.name, folder, NAME, tuple(entries), sequential_pairs(len(entries), options.step))


def _rotate_bits_back(stored: np.ndarray) -> np.ndarray:
    return (stored << np.uint16(13)) | (stored >> np.uint16(3))


def _read_info(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The colour camera's matrix, and T_world_camera by frame name."""
    blocks: dict[str, list[tuple[str, list[str]]]] = {}
    heading = ""
    for where, line in read_lines(path):
        if line.startswith("#"):
            heading = line.lstrip("# ")
        else:
            blocks.setdefault(heading, []).append((where, line.split()))
    if "Color camera intrinsic matrix" not in blocks:
        raise RecordingError(f"{path}: the heading '# Color camera intrinsic matrix' is missing")
    K = _matrix(blocks["Color camera intrinsic matrix"], 3)
    poses = {}
    for heading, rows in blocks.items():
        if found := POSE_HEADING.match(heading):
            poses[found[1]] = parse_pose(_matrix(rows, 4), rows[0][0])
    return K, poses


def _matrix(rows: list[tuple[str, list[str]]], size: int) -> np.ndarray:
    if len(rows) != size:
        raise RecordingError(f"{rows[0][0]}: expected {size} rows of {size} numbers, got {len(rows)} rows")
    return np.array([parse_numbers(words, size, where) for where, words in rows])
