"""The calibration.json of multical, which calibrates many cameras (Azure Kinects, mostly) by boards.

cameras: {name: {model, image_size: [width, height], K: 3x3, dist: OpenCV's coefficients}}
camera_poses: {name: {R: 3x3, T: 3}}         x_camera = R x_rig + T, in the unit of the board's squares
              or, relative to one camera, {master: ..., "name_to_master": {R, T}}, x_name = R x_master + T
"""

from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.json_file import json_numbers, json_object, read_json
from adagmm_fusion.formats.options import intrinsics_from_matrix
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_fusion.rigs.rig import SENSOR_NAME
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

MODELS = ("standard", "rational", "thin_prism", "tilted")
TO = "_to_"


def read_multical(path: Path, metres_per_unit: float) -> dict[str, ImportedSensor]:
    """The cameras by name, in the first one's frame. Raises RigError naming what is missing or wrong."""
    try:
        return _read(path, metres_per_unit)
    except RecordingError as problem:
        raise RigError(str(problem)) from problem


def _read(path: Path, metres_per_unit: float) -> dict[str, ImportedSensor]:
    document = json_object(read_json(path), str(path))
    cameras = json_object(document.get("cameras"), f"{path}: cameras")
    listed = json_object(document.get("camera_poses"), f"{path}: camera_poses")
    if not cameras:
        raise RecordingError(f"{path}: cameras: expected one at least, got none")
    intrinsics = {name: _intrinsics(values, name, path) for name, values in cameras.items()}
    alone = {key: _pose(value, key, path, metres_per_unit) for key, value in listed.items() if TO not in key}
    T_camera_rig = dict(alone)
    for key, value in listed.items():
        name, to, master = key.partition(TO)
        if to and master not in alone:
            raise RecordingError(f"{path}: camera_poses: {key}: there is no pose of {master}")
        if to:
            T_camera_rig[name] = _pose(value, key, path, metres_per_unit) @ alone[master]
    first = next(iter(cameras))
    if missing := [name for name in cameras if name not in T_camera_rig]:
        raise RecordingError(f"{path}: camera_poses: there is no pose of {missing[0]}")
    poses = {name: T_camera_rig[first] @ se_inverse(T_camera_rig[name]) for name in cameras}
    return {name: ImportedSensor(intrinsics[name], poses[name]) for name in cameras}


def _intrinsics(value: Any, name: str, path: Path) -> PinholeIntrinsics:
    where = f"{path}: cameras: {name[:60]}"
    if not SENSOR_NAME.fullmatch(name):
        raise RecordingError(f"{path}: cameras: the name {name[:60]!a} cannot be a sensor's")
    values = json_object(value, where)
    width, height = json_numbers(values.get("image_size"), 2, f"{where}: image_size")
    K = json_numbers(values.get("K"), 9, f"{where}: K").reshape(3, 3)
    nested = values.get("dist", [])
    coefficients = nested[0] if isinstance(nested, list) and len(nested) == 1 else nested
    count = len(coefficients) if isinstance(coefficients, list) else 0
    distortion = json_numbers(coefficients, count, f"{where}: dist")
    if distortion.any() and values.get("model", MODELS[0]) not in MODELS:
        raise RecordingError(f"{where}: model: expected {', '.join(MODELS)}, got {str(values['model'])[:40]!a}")
    plain = intrinsics_from_matrix(K, (int(width), int(height)), path)
    lens = tuple(distortion.tolist()) if distortion.any() else ()
    try:
        return PinholeIntrinsics(plain.width, plain.height, plain.fx, plain.fy, plain.cx, plain.cy, lens)
    except InputError as problem:
        raise RecordingError(f"{where}: {problem}") from problem


def _pose(value: Any, key: str, path: Path, metres_per_unit: float) -> np.ndarray:
    where = f"{path}: camera_poses: {key[:60]}"
    values = json_object(value, where)
    T = np.eye(4)
    T[:3, :3] = json_numbers(values.get("R"), 9, f"{where}: R").reshape(3, 3)
    T[:3, 3] = metres_per_unit * json_numbers(values.get("T"), 3, f"{where}: T")
    return parse_pose(T, where)
