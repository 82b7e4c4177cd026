"""MATLAB's stereoParameters (Stereo Camera Calibrator, estimateCameraParameters), saved as a structure:

    stereoParams = toStruct(stereoParams); save("rig.mat", "stereoParams", "-v7")

    CameraParameters1, CameraParameters2
        IntrinsicMatrix (3x3, transposed: for points as rows), or K (3x3); pixels are counted from 1
        RadialDistortion (2 or 3), TangentialDistortion (2)
        ImageSize                                      height, width
    RotationOfCamera2 (3x3), TranslationOfCamera2 (3)  as rows: x2 = x1 R + T, in the unit of the board's squares

What is saved without toStruct is an object of a class, of which a .mat file says nothing that others can read. Source:
MathWorks, Computer Vision Toolbox, toStruct and stereoParametersToOpenCV.
"""

from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RigError
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

VARIABLE = "stereoParams"


def stereo_parameters(path: Path, fields: Any, metres_per_unit: float) -> dict[str, ImportedSensor]:
    """The cameras camera1 and camera2, in the first one's frame, of a structure from `path`. Raises RigError."""
    if not isinstance(fields, dict):
        raise RigError(f"{path}: {VARIABLE}: expected a structure as toStruct makes it, got numbers")
    T_second_first = np.eye(4)
    T_second_first[:3, :3] = _numbers(path, fields, "RotationOfCamera2", 9).reshape(3, 3).T
    T_second_first[:3, 3] = metres_per_unit * _numbers(path, fields, "TranslationOfCamera2", 3)
    try:
        pose = se_inverse(checked_rigid_transformation(T_second_first, "RotationOfCamera2, TranslationOfCamera2"))
        cameras = [_camera(path, fields.get(f"CameraParameters{i}")) for i in (1, 2)]
    except InputError as problem:
        raise problem if isinstance(problem, RigError) else RigError(f"{path}: {problem}") from problem
    return {"camera1": ImportedSensor(cameras[0], np.eye(4)), "camera2": ImportedSensor(cameras[1], pose)}


def _camera(path: Path, fields: Any) -> PinholeIntrinsics:
    if not isinstance(fields, dict):
        raise RigError(f"{path}: {VARIABLE}: expected the structures CameraParameters1 and CameraParameters2")
    if "IntrinsicMatrix" in fields:
        K = _numbers(path, fields, "IntrinsicMatrix", 9).reshape(3, 3).T
    else:
        K = _numbers(path, fields, "K", 9).reshape(3, 3)
    if K[0, 1] != 0 or K[1, 0] != 0 or not np.array_equal(K[2], (0, 0, 1)):
        raise RigError(f"{path}: expected a camera matrix fx 0 cx / 0 fy cy / 0 0 1, got {K.tolist()}")
    radial = _numbers(path, fields, "RadialDistortion", 2, 3)
    tangential = _numbers(path, fields, "TangentialDistortion", 2)
    distortion = (*radial[:2].tolist(), *tangential.tolist(), *radial[2:].tolist())
    height, width = _numbers(path, fields, "ImageSize", 2)
    lens = distortion if any(distortion) else ()
    return PinholeIntrinsics(int(width), int(height), K[0, 0], K[1, 1], K[0, 2] - 1.0, K[1, 2] - 1.0, lens)


def _numbers(path: Path, fields: dict[str, Any], name: str, *counts: int) -> np.ndarray:
    """(count,) finite numbers of a field, row by row."""
    value = fields.get(name)
    if value is None or isinstance(value, dict) or value.size not in counts or not np.isfinite(value).all():
        wanted = " or ".join(map(str, counts))
        raise RigError(f"{path}: {VARIABLE}: {name}: expected {wanted} finite numbers")
    return np.ravel(value).astype(np.float64)
