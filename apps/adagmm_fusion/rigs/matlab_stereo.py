"""Stereo calibrations of the Camera Calibration Toolbox for MATLAB: Calib_Results_stereo.mat.

    fc_left, cc_left (2), kc_left (5), alpha_c_left     focal lengths, principal point, OpenCV's coefficients, skew
    fc_right, ...                                       the same of the right camera
    R (3x3) or om (3), T (3)                            x_right = R x_left + T, in the unit of the board's squares

It does not hold the images' size. MATLAB's own stereoParameters are read by `rigs.matlab_parameters`. Source: Bouguet's
toolbox.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.formats.matlab_file import read_variable
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse


def read_matlab_stereo(path: Path, metres_per_unit: float, size: tuple[int, int] | None) -> dict[str, ImportedSensor]:
    """The cameras left and right, in the left one's frame. Raises RigError naming the file and what is missing."""
    if size is None:
        raise RigError(f"{path}: the image size is not in it; give it with --size")
    T_right_left = np.eye(4)
    try:
        T_right_left[:3, :3] = _values(path, "R", (3, 3))
    except RigError:
        T_right_left[:3, :3] = Rotation.from_rotvec(_values(path, "om", (3,))).as_matrix()
    T_right_left[:3, 3] = metres_per_unit * _values(path, "T", (3,))
    try:
        T_left_right = se_inverse(checked_rigid_transformation(T_right_left, "R, T"))
    except InputError as problem:
        raise RigError(f"{path}: {problem}") from problem
    poses = {"left": np.eye(4), "right": T_left_right}
    return {side: ImportedSensor(_camera(path, side, size), pose) for side, pose in poses.items()}


def _camera(path: Path, side: str, size: tuple[int, int]) -> PinholeIntrinsics:
    (fx, fy), (cx, cy) = _values(path, f"fc_{side}", (2,)), _values(path, f"cc_{side}", (2,))
    if float(_values(path, f"alpha_c_{side}", ())) != 0:
        raise RigError(f"{path}: alpha_c_{side}: expected no skew; calibrate with est_alpha = 0")
    distortion = _values(path, f"kc_{side}", (5,))
    try:
        return PinholeIntrinsics(*size, fx, fy, cx, cy, tuple(distortion.tolist()) if distortion.any() else ())
    except InputError as problem:
        raise RigError(f"{path}: {problem}") from problem


def _values(path: Path, name: str, shape: tuple[int, ...]) -> np.ndarray:
    try:
        values = read_variable(path, name)
    except RecordingError as problem:
        raise RigError(str(problem)) from problem
    if isinstance(values, dict) or np.squeeze(values).shape != shape or not np.isfinite(values).all():
        raise RigError(f"{path}: {name}: expected {shape or 'one'} finite numbers")
    return np.squeeze(values).astype(np.float64)
