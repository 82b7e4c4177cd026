"""nerfstudio's transforms.json (also Instant NGP's) with depth.

    transforms.json    fl_x, fl_y, cx, cy, w, h, k1, k2, p1, p2, ... for all frames, or in a frame for it alone; or
                       camera_angle_x, the view's width [rad], in place of fl_x, and the middle in place of cx, cy;
                       camera_model PINHOLE, SIMPLE_PINHOLE or OPENCV, not is_fisheye; depth_unit_scale_factor, metres
                       a unit (without it, or Instant NGP's integer_depth_scale, whole numbers are millimetres, others
                       metres); applied_scale, by which the poses' places were multiplied; frames, each with
                         file_path, depth_file_path    relative to the folder, or in it
                         transform_matrix              4x4 camera to world in OpenGL's axes (x right, y up, z backward)

Frames without depth are passed over. Source: nerfstudio's docs, Data Conventions.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, first_readable, inside, read_color, read_depth
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.files.json_file import json_number, json_numbers, json_object, read_json
from adagmm_fusion.files.opencv_nodes import plain_name
from adagmm_fusion.formats.camera_fields import is_something
from adagmm_fusion.formats.camera_files import distortion_of
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.frames.depth_checks import usual_depth_scale
from adagmm_fusion.frames.pose_readings import OPENGL
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_fusion.rigs.lens_models import other_lens_model
from adagmm_o3d.errors import InputError

NAME = "nerfstudio"
SUMMARY = "nerfstudio folder (transforms.json with depth_file_path)"
SENSOR = "camera"
TRANSFORMS = "transforms.json"
MODELS = ("", "PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
# nerfstudio's name of the metres a unit, and Instant NGP's.
UNITS = ("depth_unit_scale_factor", "integer_depth_scale")


def matches(folder: Path) -> bool:
    return is_given(folder / TRANSFORMS)


def read(folder: Path, options: ReadOptions) -> Recording:
    path = folder / TRANSFORMS
    common = json_object(read_json(path), str(path))
    listed = common.get("frames")
    if not isinstance(listed, list):
        raise RecordingError(f"{path}: frames: expected a list of frames")
    frames: list[ListedFrame] = []
    without_depth = 0
    # The size of images, and the metres a unit of depth, where the file does not say it.
    unstated: tuple[int, int] | None = None
    usual: float | None = None
    scale = json_number(common, "applied_scale", str(path), 1.0)
    if not 1e-9 < scale < 1e9:
        raise RecordingError(f"{path}: applied_scale: expected a positive number, got {scale:g}")
    for i, item in enumerate(listed):
        where = f"{path}: frames[{i}]"
        values = common | json_object(item, where)
        if not isinstance(values.get("depth_file_path"), str):
            without_depth += 1
            continue
        color, depth = _color(folder, values.get("file_path"), where), inside(folder, values["depth_file_path"], where)
        if "w" not in values and unstated is None:
            unstated = _first_size(folder, listed, path)
        matrix = values.get("transform_matrix")
        T = np.eye(4)
        rows = 3 if isinstance(matrix, list) and len(matrix) == 3 else 4
        T[:rows] = json_numbers(matrix, 4 * rows, f"{where}: transform_matrix").reshape(rows, 4)
        T[:3, 3] /= scale
        key = next((key for key in UNITS if key in values), UNITS[0])
        if key not in values and usual is None:
            usual = _usual_unit(folder, listed, path)
        unit = json_number(values, key, where, usual)
        if not 1e-9 < unit < 1e9:
            raise RecordingError(f"{where}: {key}: expected metres a unit, got {unit:g}")
        name = depth.stem
        frames.append(
            ListedFrame(
                name, color, depth, _intrinsics(values, unstated, where), 1.0 / unit, parse_pose(T, where) @ OPENGL
            )
        )
    if not frames:
        raise RecordingError(f"{path}: no frame has depth_file_path; write it with depth")
    notes = [] if scale == 1.0 else [f"the poses' places are divided by the file's applied_scale, {scale:g}"]
    notes += [f"left out, without depth: {without_depth} of {len(listed)} frames"] if without_depth else []
    return recording_of_frames(folder, NAME, SENSOR, frames, options, notes)


def _first_size(folder: Path, listed: list[Any], path: Path) -> tuple[int, int]:
    """(width, height) of the first colour image that can be read.

    Raises
    ------
    RecordingError  of the first image, if none can be read.
    """

    def size(i: int) -> tuple[int, int]:
        where = f"{path}: frames[{i}]"
        return read_color(_color(folder, json_object(listed[i], where).get("file_path"), where)).shape[1::-1]

    return first_readable(range(len(listed)), size)


def _usual_unit(folder: Path, listed: list[Any], path: Path) -> float:
    """Metres a unit of the first depth image that can be read, by its numbers.

    Raises
    ------
    RecordingError  of the first image, if none can be read.
    """

    def unit(i: int) -> float:
        where = f"{path}: frames[{i}]"
        relative = json_object(listed[i], where).get("depth_file_path")
        if not isinstance(relative, str):
            raise RecordingError(f"{where}: has no depth_file_path")
        return 1.0 / usual_depth_scale(read_depth(inside(folder, relative, where)))

    return first_readable(range(len(listed)), unit)


def _color(folder: Path, relative: Any, where: str) -> Path:
    if not isinstance(relative, str) or not relative:
        raise RecordingError(f"{where}: file_path: expected a path, got {str(relative)[:40]!r}")
    path = inside(folder, relative, where)
    if path.suffix or path.exists():
        return path
    return next((p for s in COLOR_SUFFIXES if (p := inside(folder, relative + s, where)).exists()), path)


def _intrinsics(values: dict[str, Any], unstated: tuple[int, int] | None, where: str) -> PinholeIntrinsics:
    model = values.get("camera_model", "")
    if model not in MODELS:
        raise RecordingError(
            f"{where}: camera_model: expected OPENCV or PINHOLE, got {str(model)[:40]!r}; undistort first"
        )
    size = unstated
    if size is None or "w" in values:
        size = int(json_number(values, "w", where)), int(json_number(values, "h", where))
    if "camera_angle_x" in values and "fl_x" not in values:
        half = 0.5 * json_number(values, "camera_angle_x", where)
        if not 0.0 < half < 0.5 * math.pi:
            raise RecordingError(f"{where}: camera_angle_x: expected radians between 0 and π, got {2.0 * half:g}")
        middle = [0.5 * (pixels - 1) for pixels in size]
        fx, cx, cy = (
            0.5 * size[0] / math.tan(half),
            *(json_number(values, name, where, at) for name, at in zip(("cx", "cy"), middle, strict=True)),
        )
    else:
        fx, cx, cy = (json_number(values, name, where) for name in ("fl_x", "cx", "cy"))
    fy = json_number(values, "fl_y", where, fx)
    lens = {plain_name(name): value for name, value in values.items() if isinstance(value, int | float | list | str)}
    distortion = distortion_of(lens, where)
    if problem := other_lens_model(lens, bool(distortion)):
        raise RecordingError(f"{where}: {problem}")
    if is_something(lens.get("k4")):
        raise RecordingError(f"{where}: k4: expected 0, OpenCV's k4 means something else; undistort the images first")
    try:
        return PinholeIntrinsics(*size, fx, fy, cx, cy, distortion)
    except InputError as problem:
        raise RecordingError(f"{where}: {problem}") from problem
