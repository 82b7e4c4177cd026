"""Two fixed Asus Xtion (or more) as the PIV course of IST Lisbon records them: depth as MATLAB arrays.

    rgb_image1_7.png               RGB of sensor 1, moment 7; here or in one folder below, all together
    depth1_7.mat                   depth_array (H, W) uint16, millimetres, 0 none, not registered to the colour image
    cameraparametersAsus.mat       in the recording's folder: cam_params with Kdepth, Krgb (3x3), R (3x3), T (3) [m],
                                   where x_rgb = R x_depth + T; one set for all sensors
    T_cam1_to_cam2_reference.txt   optional, beside the images: 4x4, x_cam2 = T x_cam1, metres, colour cameras

The depth is registered to the colour image while loading. Sensors are called camera1, camera2, ...; the first one is
the target. A rig's sensor poses replace the reference; without both there is no ground truth.
"""

import re
from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import checked_frame, image_size, inside, read_color
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.formats.matlab_file import read_variable
from adagmm_fusion.formats.options import ReadOptions, intrinsics_from_matrix
from adagmm_fusion.formats.text_table import parse_pose, read_matrix
from adagmm_fusion.frames.depth_registration import register_depth
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame, checked_rigid_transformation
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

NAME = "xtion"
SUMMARY = "Xtion rig (rgb_image1_N.png, depth1_N.mat, cameraparametersAsus.mat)"
CALIBRATION = "cameraparametersAsus.mat"
REFERENCE = "T_cam1_to_cam2_reference.txt"
DEPTH_SCALE = 1000.0
DEPTH_NAME = re.compile(r"depth(\d+)_(\d+)\.mat")


def matches(folder: Path) -> bool:
    return is_given(folder / CALIBRATION)


def read(folder: Path, options: ReadOptions) -> Recording:
    images = sorted({path.parent for pattern in ("depth*_*.mat", "*/depth*_*.mat") for path in folder.glob(pattern)})
    if len(images) != 1:
        got = " and ".join(map(str, images)) or "none"
        raise RecordingError(f"{folder}: expected one folder with depth1_N.mat files, got {got}")
    found = [DEPTH_NAME.fullmatch(path.name) for path in images[0].glob("depth*_*.mat")]
    numbers = {(int(match[1]), int(match[2])) for match in found if match}
    sensors = sorted({sensor for sensor, _ in numbers})
    moments = sorted({moment for _, moment in numbers})
    if len(sensors) < 2:
        raise RecordingError(f"{images[0]}: expected depth images of two sensors, got {len(sensors)}")
    size = image_size(images[0] / f"rgb_image{sensors[0]}_{moments[0]}.png")
    K_depth, K_color, T_color_depth = _read_calibration(folder / CALIBRATION)
    color_intrinsics = intrinsics_from_matrix(K_color, size, folder / CALIBRATION)
    poses = _sensor_poses(images[0] / REFERENCE, sensors, options)
    entries = []
    for moment in moments:
        for sensor in sensors:
            name = f"camera{sensor}"
            intrinsics, depth_scale = options.calibration(name, color_intrinsics, DEPTH_SCALE, folder)
            where, relative = str(images[0]), images[0].relative_to(folder)
            color = inside(folder, str(relative / f"rgb_image{sensor}_{moment}.png"), where)
            depth = inside(folder, str(relative / f"depth{sensor}_{moment}.mat"), where)
            load = partial(_load, str(moment), name, color, depth, K_depth, T_color_depth, intrinsics, depth_scale)
            entries.append(FrameEntry(str(moment), name, load, poses[sensor], depth_file=depth))
    first = range(0, len(entries), len(sensors))
    pairs = tuple(PairEntry(i + other, i) for i in first for other in range(1, len(sensors)))
    return Recording(folder.name, folder, NAME, tuple(entries), pairs)


def _load(
    name: str,
    sensor: str,
    color_path: Path,
    depth_path: Path,
    K_depth: np.ndarray,
    T_color_depth: np.ndarray,
    intrinsics: PinholeIntrinsics,
    depth_scale: float,
) -> RGBDFrame:
    color = read_color(color_path)
    if color.shape[:2] != (intrinsics.height, intrinsics.width):
        wanted = f"{intrinsics.width}x{intrinsics.height}"
        raise RecordingError(
            f"{color_path}: expected {wanted} pixels, as the intrinsics, got {color.shape[1]}x{color.shape[0]}"
        )
    stored = read_variable(depth_path, "depth_array")
    if not isinstance(stored, np.ndarray):
        raise RecordingError(f"{depth_path}: depth_array: expected (H, W) uint16, got a structure")
    if stored.dtype != np.uint16 or stored.ndim != 2:
        raise RecordingError(f"{depth_path}: depth_array: expected (H, W) uint16, got {stored.shape} {stored.dtype}")
    depth_intrinsics = intrinsics_from_matrix(K_depth, stored.shape[::-1], depth_path)
    depth = register_depth(stored, depth_intrinsics, intrinsics, T_color_depth, depth_scale)
    return checked_frame(depth_path, name, color, depth, intrinsics, depth_scale, sensor)


def _read_calibration(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K_depth, K_color, T_color_depth."""
    parameters = read_variable(path, "cam_params")
    shapes = {"Kdepth": (3, 3), "Krgb": (3, 3), "R": (3, 3), "T": (3,)}
    if not isinstance(parameters, dict) or any(np.squeeze(parameters.get(k, 0)).shape != s for k, s in shapes.items()):
        raise RecordingError(f"{path}: cam_params: expected Kdepth, Krgb, R (3x3) and T (3)")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.squeeze(parameters["R"]), np.squeeze(parameters["T"])
    try:
        T = checked_rigid_transformation(T, "cam_params R, T")
    except InputError as problem:
        raise RecordingError(f"{path}: {problem}") from problem
    return parameters["Kdepth"], parameters["Krgb"], T


def _sensor_poses(reference: Path, sensors: list[int], options: ReadOptions) -> dict[int, np.ndarray | None]:
    if options.rig is not None:
        return {sensor: options.sensor_pose(f"camera{sensor}") for sensor in sensors}
    poses = dict.fromkeys(sensors)
    if is_given(reference):
        T_cam2_cam1 = parse_pose(read_matrix(reference, 4, 4), str(reference))
        poses |= {1: np.eye(4), 2: se_inverse(T_cam2_cam1)}
    return poses
