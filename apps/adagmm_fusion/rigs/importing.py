"""Calibrations of other programs as a rig: ROS camera_info YAML and OpenCV FileStorage (YAML, XML or JSON).

ROS camera_info, as camera_calibration writes it or `rostopic echo` prints it, one camera a file:
    image_width, image_height            or width, height
    camera_matrix: {rows, cols, data}    or K (k), a list of 9
    distortion_model                     plumb_bob or rational_polynomial, by whatever name
    or, as ORB-SLAM has it, Camera.fx, Camera.fy, ..., Camera.k1, ..., Camera.width (or Camera1.fx)
    depth_scale, DepthMapFactor, depth_units             optional; see rigs/depth_units.py
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
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from adagmm_fusion.errors import RigError
from adagmm_fusion.files.input_file import check_input, read_input
from adagmm_fusion.files.opencv_nodes import OpenCVNodes, plain_name, read_nodes
from adagmm_fusion.files.strict_yaml import NUMBER, Item, read_yaml
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_fusion.rigs.depth_units import depth_scale_of
from adagmm_fusion.rigs.lens_models import is_opencv_model, other_lens_model, wanted_model
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

# Names of OpenCV's files, small and without underscores.
MATRIX_NAMES = ("cameramatrix", "intrinsicmatrix", "k")
DISTORTION_NAMES = (
    "distortioncoefficients", "distortioncoeffs", "distortioncoeff", "distortion", "distcoeffs", "distcoeff",
    "distcoefs", "distcoef", "cameradistortion", "dist", "d",
)  # fmt: skip
SIZE_NAMES = ("imagesize", "imgsize", "resolution")
WIDTHS = ("width", "w", "imagewidth", "imgwidth", "imwidth", "camera.width")
HEIGHTS = ("height", "h", "imageheight", "imgheight", "imheight", "camera.height")
ROTATION_NAMES, TRANSLATION_NAMES = ("r", "rotation"), ("t", "translation")
# What such a name may also be called; one that is not read must not be passed over.
SPEAKS_OF_DISTORTION = re.compile(r"dist(?!ance)|coeff|(^|[^a-z])(k[1-6c]|[kp]_?[1-6]|d[0-9]*)$", re.IGNORECASE)
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
# A skew of so small a share of the focal length is what rounding leaves.
ROUNDING = 1e-6
OPENCV_MARKS = (b"%YAML:1.0", b"opencv_storage", b"opencv-matrix")


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a file says of one camera: the matrix K (3, 3) and the lens distortion; the image's (width, height), the
    depth units a metre and `T_stereo_camera` (4, 4), its pose in the rectified frame that it shares with the other
    camera, where it says them."""

    K: np.ndarray
    size: tuple[int, int] | None = None
    distortion: tuple[float, ...] = ()
    depth_scale: float | None = None
    T_stereo_camera: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class ImportedCamera:
    """`T_stereo_camera` and `depth_scale` as in Calibration."""

    intrinsics: PinholeIntrinsics
    T_stereo_camera: np.ndarray | None = None
    depth_scale: float | None = None


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
    camera = read_calibration(path, number)
    size = camera.size or size
    if size is None:
        raise RigError(f"{path}: the image size is not in it; give it with --size")
    K = camera.K
    try:
        intrinsics = PinholeIntrinsics(*size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], camera.distortion)
    except InputError as problem:
        raise RigError(f"{path}: {problem}") from problem
    return ImportedCamera(intrinsics, camera.T_stereo_camera, camera.depth_scale)


def read_calibration(path: Path, number: int = 1) -> Calibration:
    """As `read_camera`, of a file that need not say the image's size."""
    start = read_input(path, RigError, count=4096)
    if any(mark in start for mark in OPENCV_MARKS) or path.suffix.lower() in (".xml", ".json"):
        return _opencv_camera(path, number)
    return _ros_camera(path)


def without_rounding(K: np.ndarray) -> np.ndarray:
    """A camera matrix without a skew that is no more than what rounding leaves."""
    K = np.array(K, dtype=float)
    if K.shape == (3, 3):
        small = ROUNDING * abs(K[0, 0])
        for row, column in ((0, 1), (1, 0)):
            K[row, column] = 0.0 if abs(K[row, column]) <= small else K[row, column]
    return K


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


def _matrix(path: Path, K: ArrayLike) -> np.ndarray:
    K = without_rounding(np.asarray(K, dtype=float))
    if K.shape != (3, 3) or K[0, 1] != 0 or K[1, 0] != 0 or not np.array_equal(K[2], (0, 0, 1)):
        raise RigError(f"{path}: expected a camera matrix fx 0 cx / 0 fy cy / 0 0 1, got {K.tolist()}")
    return K


def _nodes(path: Path, names: tuple[str, ...]) -> OpenCVNodes:
    check_input(path, RigError)
    nodes = read_nodes(path, names)
    if nodes is None:
        raise RigError(
            f"{path}: OpenCV cannot read it, or a matrix in it has no numbers; it is damaged or something else"
        )
    return nodes


def _opencv_camera(path: Path, number: int) -> Calibration:
    matrix_names = (*MATRIX_NAMES, *(f"{name}{number}" for name in ("m", *MATRIX_NAMES)))
    distortion_names = (*DISTORTION_NAMES, *(f"{name}{number}" for name in DISTORTION_NAMES))
    nodes = _nodes(path, (*matrix_names, *distortion_names, *SIZE_NAMES))
    K, by_name = nodes.first(matrix_names), _named_values(nodes.scalars, number)
    if K is None and by_name is not None:
        K = by_name[0]
    if K is None:
        raise RigError(f"{path}: expected a camera matrix called camera_matrix, cameraMatrix, K or M{number}, got none")
    distortion = nodes.first(distortion_names)
    if distortion is None:
        of_others = {f"{name}{other}" for name in DISTORTION_NAMES for other in range(10)}
        read = of_others if by_name is None else {*of_others, *by_name[2]}
        distortion = None if by_name is None else by_name[1]
        unread = [k for k in nodes.keys if plain_name(k) not in read and SPEAKS_OF_DISTORTION.search(k)]
        if unread:
            raise RigError(
                f"{path}: {unread[0]}: is it the lens distortion? It is not read under this name; "
                "call it distortion_coefficients (OpenCV's order) or take it out"
            )
    lens = tuple(np.ravel(distortion).tolist()) if distortion is not None and np.any(distortion) else ()
    said = nodes.scalars | nodes.texts
    if problem := other_lens_model(said, any(lens)):
        raise RigError(f"{path}: {problem}")
    return Calibration(_matrix(path, K), _opencv_size(path, nodes), lens, _depth_scale(path, said))


def _opencv_size(path: Path, nodes: OpenCVNodes) -> tuple[int, int] | None:
    both = nodes.first(SIZE_NAMES)
    width, height = (next((nodes.scalars[n] for n in names if n in nodes.scalars), None) for names in (WIDTHS, HEIGHTS))
    if both is None and width is not None and height is not None:
        both = np.array([width, height])
    if both is None:
        return None
    if both.shape != (2,) or not np.isfinite(both).all():
        raise RigError(f"{path}: expected an image size of two numbers, got {both.tolist()}")
    return int(both[0]), int(both[1])


def _named_values(scalars: Mapping[str, float], number: int) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]] | None:
    """K, the coefficients and their names, where they are single numbers as ORB-SLAM's Camera.fx; None without."""
    for prefix in ("", "camera.", f"camera{number}."):
        values = [scalars.get(f"{prefix}{name}") for name in ("fx", "fy", "cx", "cy")]
        if None in values:
            continue
        names = tuple(f"{prefix}{name}" for name in COEFFICIENTS)
        lens = np.array([scalars.get(name, 0.0) for name in names])
        fx, fy, cx, cy = values
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], dtype=float), lens[: 8 if lens[5:].any() else 5], names
    return None


def _ros_camera(path: Path) -> Calibration:
    keys = read_yaml(path, RigError).mapping()
    plain = {plain_name(key): item for key, item in keys.items()}

    def find(*names: str) -> Item | None:
        return next((keys[name] for name in names if name in keys), None)

    def need(*names: str) -> Item:
        item = find(*names)
        if item is None:
            raise RigError(f"{path}: expected a ROS camera_info or OpenCV calibration, there is no {names[0]}")
        return item

    said = {name: value for name, item in plain.items() if (value := _scalar(item)) is not None}
    depth_scale = _depth_scale(path, said)
    size = _ros_size(plain)
    by_name = _named_values({name: value for name, value in said.items() if isinstance(value, float)}, 1)
    if by_name is not None and find("camera_matrix", "K", "k") is None:
        K, coefficients, read = by_name
        unread = [key for key in keys if plain_name(key) not in read and SPEAKS_OF_DISTORTION.search(key)]
        if unread:
            keys[unread[0]].fail(
                "is it the lens distortion? It is not read under this name; call it k1, k2, p1, p2, k3"
            )
        if problem := other_lens_model(said, bool(coefficients.any())):
            raise RigError(f"{path}: {problem}")
        lens = tuple(coefficients.tolist()) if coefficients.any() else ()
        return Calibration(_matrix(path, K), size, lens, depth_scale)
    if size is None:
        need("image_width", "width")
        need("image_height", "height")
    K = _matrix(path, _numbers(need("camera_matrix", "K", "k"), 9).reshape(3, 3))
    distortion = _numbers(need("distortion_coefficients", "D", "d"))
    model = find("distortion_model")
    if model is not None and not is_opencv_model(model.text()) and np.any(distortion):
        model.fail(wanted_model(model.value))
    if problem := other_lens_model(said, bool(np.any(distortion))):
        raise RigError(f"{path}: {problem}")
    lens = tuple(distortion.tolist()) if np.any(distortion) else ()
    camera = Calibration(K, size, lens, depth_scale)
    R, P = find("rectification_matrix", "R", "r"), find("projection_matrix", "P", "p")
    if R is None or P is None:
        return camera
    projection = _numbers(P, 12).reshape(3, 4)
    if projection[0, 0] == 0:  # an uncalibrated one is all zeros
        return camera
    T_rectified_camera = np.eye(4)
    T_rectified_camera[:3, :3] = _numbers(R, 9).reshape(3, 3)
    try:
        T = checked_rigid_transformation(T_rectified_camera, "rectification_matrix")
    except InputError as problem:
        raise RigError(f"{path}: {problem}") from problem
    # The rectified camera looks along the common frame's axes from where P's last column says: P = K' [I | -position].
    T[0, 3], T[1, 3] = -projection[0, 3] / projection[0, 0], -projection[1, 3] / projection[1, 1]
    return replace(camera, T_stereo_camera=T)


def _depth_scale(path: Path, said: Mapping[str, float | str]) -> float | None:
    # ORB-SLAM3 writes RGBD.DepthMapFactor.
    return depth_scale_of({name.rpartition(".")[2]: value for name, value in said.items()}, str(path), RigError)


def _scalar(item: Item) -> float | str | None:
    """A number or a text; None where it is a list or a mapping."""
    if not isinstance(item.value, str):
        return None
    return float(item.value) if NUMBER.fullmatch(item.value) and not item.quoted else item.value


def _ros_size(plain: Mapping[str, Item]) -> tuple[int, int] | None:
    """The image's size; None without, or with one half of it."""
    width, height = (next((plain[n] for n in names if n in plain), None) for names in (WIDTHS, HEIGHTS))
    if width is not None and height is not None:
        return width.integer(), height.integer()
    both = next((plain[name] for name in SIZE_NAMES if name in plain), None)
    if both is None:
        return None
    if len(both.sequence()) != 2:
        both.fail(f"expected width and height, got {len(both.sequence())} values")
    return both.sequence()[0].integer(), both.sequence()[1].integer()


def _numbers(item: Item, count: int | None = None) -> np.ndarray:
    data = item.value["data"] if isinstance(item.value, dict) and "data" in item.value else item
    numbers = data.numbers()
    if count is not None and len(numbers) != count:
        data.fail(f"expected {count} numbers, got {len(numbers)}")
    return np.array(numbers)
