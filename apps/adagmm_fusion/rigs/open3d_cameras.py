"""Open3D's PinholeCameraTrajectory (or one PinholeCameraParameters) JSON as a rig.

parameters: list of
    intrinsic: {width, height, intrinsic_matrix: 9 numbers, column by column}
    extrinsic: 16 numbers, column by column, world to camera, metres as a rule
"""

from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.json_file import json_number, json_numbers, json_object, read_json
from adagmm_fusion.formats.options import intrinsics_from_matrix
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_o3d.lie import se_inverse


def read_open3d_cameras(path: Path, metres_per_unit: float = 1.0) -> dict[str, ImportedSensor]:
    """The cameras camera0, camera1, ..., in the first one's frame. Raises RigError naming what is wrong."""
    try:
        return _read(path, metres_per_unit)
    except RecordingError as problem:
        raise RigError(str(problem)) from problem


def _read(path: Path, metres_per_unit: float) -> dict[str, ImportedSensor]:
    document = json_object(read_json(path), str(path))
    listed = document.get("parameters", [document])
    if not isinstance(listed, list) or not listed:
        raise RecordingError(f"{path}: parameters: expected a list of cameras")
    sensors = {}
    T_rig_world = None
    for i, item in enumerate(listed):
        where = f"{path}: parameters[{i}]"
        values = json_object(item, where)
        intrinsic = json_object(values.get("intrinsic"), f"{where}: intrinsic")
        size = tuple(int(json_number(intrinsic, name, where)) for name in ("width", "height"))
        K = json_numbers(intrinsic.get("intrinsic_matrix"), 9, f"{where}: intrinsic_matrix").reshape(3, 3).T
        T = json_numbers(values.get("extrinsic"), 16, f"{where}: extrinsic").reshape(4, 4).T.copy()
        T[:3, 3] *= metres_per_unit
        T_camera_world = parse_pose(T, where)
        T_rig_world = T_camera_world if T_rig_world is None else T_rig_world
        pose = np.eye(4) if i == 0 else T_rig_world @ se_inverse(T_camera_world)
        sensors[f"camera{i}"] = ImportedSensor(intrinsics_from_matrix(K, (size[0], size[1]), path), pose)
    return sensors
