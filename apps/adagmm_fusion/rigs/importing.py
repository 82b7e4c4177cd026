"""Calibrations of other programs as a rig: ROS camera_info YAML and OpenCV FileStorage (YAML, XML or JSON).

ROS camera_info, as camera_calibration writes it or `rostopic echo` prints it, one camera a file:
    image_width, image_height            or width, height
    camera_matrix: {rows, cols, data}    or K (k), a list of 9
    distortion_model                     plumb_bob or rational_polynomial
    distortion_coefficients: {...}       or D (d), a list
    rectification_matrix, projection_matrix, or R, P (r, p): where they say so, the two cameras' relative pose [m]

OpenCV FileStorage, under the names its samples and iai_kinect2 use, whatever their case and underscores; the second
camera of a stereo file has the names with a 2:
    camera_matrix, K, or M1, camera_matrix1, K1                                          3x3
    distortion_coefficients, dist_coeffs, D, or D1, dist_coeffs1, and the like           optional
    image_width, image_height or image_size (width, height)                              optional
    R, T, or rotation, translation (in a stereo file)                                    x2 = R x1 + T
A name that speaks of a distortion and is none of these is refused: coefficients are never left out in silence.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from adagmm_fusion.errors import RigError
from adagmm_fusion.files.input_file import check_input, read_input
from adagmm_fusion.files.opencv_nodes import OpenCVNodes, plain_name, read_nodes
from adagmm_fusion.files.strict_yaml import Item, read_yaml
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

ROS_MODELS = ("plumb_bob", "rational_polynomial")
# Names of OpenCV's files, small and without underscores.
MATRIX_NAMES = ("cameramatrix", "intrinsicmatrix", "k")
DISTORTION_NAMES = (
    "distortioncoefficients", "distortioncoeffs", "distortioncoeff", "distortion", "distcoeffs", "distcoeff",
    "distcoefs", "distcoef", "cameradistortion", "dist", "d",
)  # fmt: skip
SIZE_NAMES = ("imagesize", "imagewidth", "imageheight")
ROTATION_NAMES, TRANSLATION_NAMES = ("r", "rotation"), ("t", "translation")
# What such a name may also be called; one that is not read must not be passed over.
SPEAKS_OF_DISTORTION = re.compile(r"dist(?!ance)|coeff|(^|[^a-z])(k[1-6c]|[kp]_?[1-6]|d[0-9]*)$", re.IGNORECASE)
OPENCV_MARKS = (b"%YAML:1.0", b"opencv_storage", b"opencv-matrix")


@dataclass(frozen=True, eq=False)
class ImportedCamera:
    """`T_stereo_camera` (4, 4): its pose in the rectified frame that it shares with the other camera, or None."""

    intrinsics: PinholeIntrinsics
    T_stereo_camera: np.ndarray | None = None


def read_camera(path: str | Path, number: int = 1, size: tuple[int, int] | None = None) -> ImportedCamera:
    """One camera's calibration.

    Parameters
    ----------
    number : which camera of an OpenCV stereo file, from 1.    size : (width, height) where the file has none.

    Raises
    ------
    RigError  naming the file and what is missing or wrong.
    """
    path = Path(path)
    start = read_input(path, RigError, count=4096)
    if any(mark in start for mark in OPENCV_MARKS) or path.suffix.lower() in (".xml", ".json"):
        return ImportedCamera(_opencv_camera(path, number, size))
    return _ros_camera(path)


def read_stereo_pose(path: str | Path, metres_per_unit: float) -> np.ndarray:
    """T_first_second (4, 4) [m] from R and T of an OpenCV file, whose T is in units of `metres_per_unit`."""
    nodes = _nodes(Path(path), (*ROTATION_NAMES, *TRANSLATION_NAMES))
    R, t = nodes.first(ROTATION_NAMES), nodes.first(TRANSLATION_NAMES)
    if R is None or t is None or R.shape != (3, 3) or t.size != 3:
        raise RigError(f"{path}: expected R (3x3) and T (3) of a stereo calibration")
    T_second_first = np.eye(4)
    T_second_first[:3, :3], T_second_first[:3, 3] = R, metres_per_unit * t.ravel()
    try:
        return se_inverse(checked_rigid_transformation(T_second_first, "R, T"))
    except InputError as problem:
        raise RigError(f"{path}: {problem}") from problem


def _intrinsics(path: Path, size: tuple[int, int], K: ArrayLike, distortion: ArrayLike) -> PinholeIntrinsics:
    K = np.asarray(K, dtype=float)
    if K.shape != (3, 3) or K[0, 1] != 0 or K[1, 0] != 0 or not np.array_equal(K[2], (0, 0, 1)):
        raise RigError(f"{path}: expected a camera matrix fx 0 cx / 0 fy cy / 0 0 1, got {K.tolist()}")
    try:
        return PinholeIntrinsics(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(np.ravel(distortion).tolist()))
    except InputError as problem:
        raise RigError(f"{path}: {problem}") from problem


def _nodes(path: Path, names: tuple[str, ...]) -> OpenCVNodes:
    check_input(path, RigError)
    nodes = read_nodes(path, names)
    if nodes is None:
        raise RigError(
            f"{path}: OpenCV cannot read it, or a matrix in it has no numbers; it is damaged or something else"
        )
    return nodes


def _opencv_camera(path: Path, number: int, size: tuple[int, int] | None) -> PinholeIntrinsics:
    matrix_names = (*MATRIX_NAMES, *(f"{name}{number}" for name in ("m", *MATRIX_NAMES)))
    distortion_names = (*DISTORTION_NAMES, *(f"{name}{number}" for name in DISTORTION_NAMES))
    nodes = _nodes(path, (*matrix_names, *distortion_names, *SIZE_NAMES))
    K = nodes.first(matrix_names)
    if K is None:
        raise RigError(f"{path}: expected a camera matrix called camera_matrix, cameraMatrix, K or M{number}, got none")
    distortion = nodes.first(distortion_names)
    if distortion is None:
        of_others = {f"{name}{other}" for name in DISTORTION_NAMES for other in range(10)}
        unread = [k for k in nodes.keys if plain_name(k) not in of_others and SPEAKS_OF_DISTORTION.search(k)]
        if unread:
            raise RigError(
                f"{path}: {unread[0]}: is it the lens distortion? It is not read under this name; "
                "call it distortion_coefficients (OpenCV's order) or take it out"
            )
    both = nodes.first(SIZE_NAMES[:1])
    if both is None and all(name in nodes.numbers for name in SIZE_NAMES[1:]):
        both = np.array([nodes.numbers[name] for name in SIZE_NAMES[1:]])
    if both is not None:
        if both.shape != (2,) or not np.isfinite(both).all():
            raise RigError(f"{path}: expected an image size of two numbers, got {both.tolist()}")
        size = int(both[0]), int(both[1])
    if size is None:
        raise RigError(f"{path}: the image size is not in it; give it with --size")
    return _intrinsics(path, size, K, () if distortion is None else distortion)


def _ros_camera(path: Path) -> ImportedCamera:
    keys = read_yaml(path, RigError).mapping()

    def find(*names: str) -> Item | None:
        return next((keys[name] for name in names if name in keys), None)

    def need(*names: str) -> Item:
        item = find(*names)
        if item is None:
            raise RigError(f"{path}: expected a ROS camera_info or OpenCV calibration, there is no {names[0]}")
        return item

    size = need("image_width", "width").integer(), need("image_height", "height").integer()
    K = _numbers(need("camera_matrix", "K", "k"), 9).reshape(3, 3)
    distortion = _numbers(need("distortion_coefficients", "D", "d"))
    model = find("distortion_model")
    if model is not None and model.text() not in ROS_MODELS and np.any(distortion):
        model.fail(f"expected {' or '.join(ROS_MODELS)}, got {model.value}; calibrate with one of these models")
    intrinsics = _intrinsics(path, size, K, distortion if np.any(distortion) else ())
    R, P = find("rectification_matrix", "R", "r"), find("projection_matrix", "P", "p")
    if R is None or P is None:
        return ImportedCamera(intrinsics)
    projection = _numbers(P, 12).reshape(3, 4)
    if projection[0, 0] == 0:  # an uncalibrated one is all zeros
        return ImportedCamera(intrinsics)
    T_rectified_camera = np.eye(4)
    T_rectified_camera[:3, :3] = _numbers(R, 9).reshape(3, 3)
    try:
        T = checked_rigid_transformation(T_rectified_camera, "rectification_matrix")
    except InputError as problem:
        raise RigError(f"{path}: {problem}") from problem
    # The rectified camera looks along the common frame's axes from where P's last column says: P = K' [I | -position].
    T[0, 3], T[1, 3] = -projection[0, 3] / projection[0, 0], -projection[1, 3] / projection[1, 1]
    return ImportedCamera(intrinsics, T)


def _numbers(item: Item, count: int | None = None) -> np.ndarray:
    data = item.value["data"] if isinstance(item.value, dict) and "data" in item.value else item
    numbers = data.numbers()
    if count is not None and len(numbers) != count:
        data.fail(f"expected {count} numbers, got {len(numbers)}")
    return np.array(numbers)
