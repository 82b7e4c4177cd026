"""One scene of a BOP data set (T-LESS, YCB-V, LM-O, ...).

    scene_camera.json    for each image's number: cam_K (9 numbers), depth_scale (millimetres a unit); cam_R_w2c (9) and
                         cam_t_w2c (3, millimetres), world to camera, where they are known
    rgb/000000.png       or .jpg; or gray/
    depth/000000.png     16 bit, registered to the colour image

Every image may have other intrinsics. Source: Hodan et al. 2018, bop_toolkit's docs/bop_datasets_format.md.
"""

from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, inside, read_color
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.files.json_file import json_number, json_numbers, json_object, read_json
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions, intrinsics_from_matrix
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.lie import se_inverse

NAME = "bop"
SUMMARY = "BOP scene (scene_camera.json, rgb/, depth/)"
SENSOR = "camera"
MILLIMETRES_PER_METRE = 1000.0
CAMERAS = "scene_camera.json"


def matches(folder: Path) -> bool:
    return is_given(folder / CAMERAS)


def read(folder: Path, options: ReadOptions) -> Recording:
    path = folder / CAMERAS
    frames = []
    cameras = json_object(read_json(path), str(path))
    for key in cameras:
        if not (key.isascii() and key.isdecimal() and len(key) < 10):
            raise RecordingError(f"{path}: expected the numbers of images, got {key[:40]!r}")
    size = None
    for key in sorted(cameras, key=int):
        where = f"{path}: {key}"
        values = json_object(cameras[key], where)
        color, depth = _color(folder, int(key)), inside(folder, f"depth/{int(key):06d}.png", where)
        if color is None and not depth.exists():  # a trimmed copy
            continue
        if color is None:
            color = inside(folder, f"rgb/{int(key):06d}.png", where)
        elif size is None:
            size = read_color(color).shape[1::-1]
        scale = json_number(values, "depth_scale", where, 1.0)
        if not 1e-9 < scale < 1e9:
            raise RecordingError(f"{where}: depth_scale: expected millimetres a unit, got {scale:g}")
        K = json_numbers(values.get("cam_K"), 9, f"{where}: cam_K").reshape(3, 3)
        intrinsics = None if size is None else intrinsics_from_matrix(K, size, path)
        frames.append(
            ListedFrame(
                f"{int(key):06d}", color, depth, intrinsics, MILLIMETRES_PER_METRE / scale, _pose(values, where)
            )
        )
    return recording_of_frames(folder, NAME, SENSOR, frames, options)


def _color(folder: Path, number: int) -> Path | None:
    paths = [
        inside(folder, f"{kind}/{number:06d}{suffix}", str(folder))
        for kind in ("rgb", "gray")
        for suffix in COLOR_SUFFIXES
    ]
    return next((path for path in paths if path.exists()), None)


def _pose(values: dict[str, Any], where: str) -> np.ndarray | None:
    if "cam_R_w2c" not in values or "cam_t_w2c" not in values:
        return None
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3] = json_numbers(values["cam_R_w2c"], 9, f"{where}: cam_R_w2c").reshape(3, 3)
    T_camera_world[:3, 3] = json_numbers(values["cam_t_w2c"], 3, f"{where}: cam_t_w2c") / MILLIMETRES_PER_METRE
    return se_inverse(parse_pose(T_camera_world, where))
