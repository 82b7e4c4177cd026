"""A camera's intrinsics in whatever small file people keep them.

.txt, .csv, .npy    3x3 or 4x4 matrix, or four numbers fx fy cx cy, or lines "fx: 525"
.json               anywhere in it: fx (fl_x, focal_x), fy, cx (ppx), cy (ppy), or a matrix called K, camera_matrix,
                    intrinsic_matrix, intrinsics, cam_K, row by row or, as Open3D writes it, column by column;
                    width (w), height (h); k1 k2 p1 p2 k3 or a list distortion, dist_coeffs, D; depth_scale
.yaml, .yml, .xml   as ROS or OpenCV write them; see rigs/importing.py
"""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.files.input_file import read_input_text
from adagmm_fusion.files.json_file import json_number, json_numbers, read_json
from adagmm_fusion.files.opencv_nodes import plain_name
from adagmm_fusion.formats.options import intrinsics_from_matrix
from adagmm_fusion.frames.rgbd import DISTORTION_LENGTHS, PinholeIntrinsics
from adagmm_fusion.rigs.importing import DISTORTION_NAMES, MATRIX_NAMES, SPEAKS_OF_DISTORTION, read_camera
from adagmm_o3d.errors import InputError

SUFFIXES = (".txt", ".csv", ".npy", ".json", ".yaml", ".yml", ".xml")
FILE_NAME = re.compile(r"intrinsic|calib|camera|(^|[^a-z])(k|cam|cam_params)([^a-z]|$)", re.IGNORECASE)
FOLDER_NAME = re.compile(r"intrinsic|calib|camera", re.IGNORECASE)
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
SCALARS = {
    "fx": ("fx", "flx", "focalx", "focallengthx"),
    "fy": ("fy", "fly", "focaly", "focallengthy"),
    "cx": ("cx", "ppx", "principalpointx"),
    "cy": ("cy", "ppy", "principalpointy"),
}
SIZES = {"width": ("width", "w", "imagewidth"), "height": ("height", "h", "imageheight")}
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
SCALES = ("depthscale", "depthfactor", "depthmapfactor", "pngdepthscale", "integerdepthscale")
MAX_DEPTH = 8


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What a file says of a camera: the matrix K (3, 3), the image's (width, height), the lens distortion and the depth
    units per metre; None where it does not say."""

    path: Path
    K: np.ndarray
    size: tuple[int, int] | None = None
    distortion: tuple[float, ...] = ()
    depth_scale: float | None = None

    def intrinsics(self, sizes: tuple[tuple[int, int], ...]) -> PinholeIntrinsics:
        """For the size that the file names, else for that of `sizes` whose middle is next to the principal point."""
        size = self.size
        if size is None:
            size = min(sizes, key=lambda s: abs(self.K[0, 2] / s[0] - 0.5) + abs(self.K[1, 2] / s[1] - 0.5))
        k = intrinsics_from_matrix(self.K, size, self.path)
        try:
            return PinholeIntrinsics(k.width, k.height, k.fx, k.fy, k.cx, k.cy, self.distortion)
        except InputError as problem:
            raise RecordingError(f"{self.path}: {problem}") from problem


def find_camera_files(folder: Path) -> list[Path]:
    """The files that by their names may hold a calibration, in the folder and in those below that are named so."""
    places = [folder, *(p for p in sorted(folder.iterdir()) if p.is_dir() and FOLDER_NAME.search(p.name))]
    found = []
    for place in places:
        for path in sorted(place.iterdir()):
            if path.suffix.lower() in SUFFIXES and FILE_NAME.search(path.stem if place == folder else f"k_{path.stem}"):
                found.append(inside(folder, str(path.relative_to(folder)), str(folder)))
    return [path for path in found if not path.is_dir()]


def read_camera_file(path: Path) -> CameraFile | None:
    """What a file says of a camera, or None if it is about something else.

    Raises
    ------
    RecordingError  if it cannot be read, or speaks of a lens distortion that is not understood.
    """
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml", ".xml"):
        return _from_ros_or_opencv(path)
    if suffix == ".json":
        return _from_mapping(path, _flattened(read_json(path)))
    if suffix == ".npy":
        from adagmm_fusion.files.image_files import read_depth

        return _from_numbers(path, read_depth(path).astype(np.float64).ravel().tolist())
    text = read_input_text(path, RecordingError)[:100_000]
    named = dict(re.findall(rf"^\s*([A-Za-z_]\w*)\s*[:=]\s*({NUMBER.pattern})\s*;?\s*$", text, re.MULTILINE))
    if named:
        return _from_mapping(path, {plain_name(name): float(value) for name, value in named.items()})
    if re.search(r"[A-Za-z]", re.sub(r"#.*|[eE](?=[-+]?\d)", "", text)):
        return None
    return _from_numbers(path, [float(word) for word in NUMBER.findall(re.sub(r"#.*", "", text))])


def _from_numbers(path: Path, numbers: list[float]) -> CameraFile | None:
    if not all(math.isfinite(x) for x in numbers):
        raise RecordingError(f"{path}: expected finite numbers")
    if len(numbers) in (9, 16):
        side = math.isqrt(len(numbers))
        return CameraFile(path, _upright(np.reshape(numbers, (side, side))[:3, :3]))
    if len(numbers) == 4:
        fx, fy, cx, cy = numbers
        return CameraFile(path, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
    return None


def _from_ros_or_opencv(path: Path) -> CameraFile | None:
    try:
        k = read_camera(path).intrinsics
    except RigError as problem:
        raise RecordingError(str(problem)) from problem
    return CameraFile(path, k.matrix(), (k.width, k.height), k.distortion)


def _flattened(value: Any, depth: int = 0) -> dict[str, Any]:
    """All keys of nested objects, without case and underscores; the outermost of equal ones counts."""
    if not isinstance(value, dict) or depth > MAX_DEPTH:
        return {}
    flat: dict[str, Any] = {}
    for inner in value.values():
        flat = _flattened(inner, depth + 1) | flat
    return flat | {plain_name(key): item for key, item in value.items()}


def _from_mapping(path: Path, values: dict[str, Any]) -> CameraFile | None:
    def first(names: tuple[str, ...]) -> str | None:
        return next((name for name in names if name in values), None)

    where = str(path)
    keys = {name: first(names) for name, names in SCALARS.items()}
    matrix = next(
        (n for n in (*MATRIX_NAMES, "camk", "intrinsics", "intrinsic") if isinstance(values.get(n), list)), None
    )
    if all(keys.values()):
        fx, fy, cx, cy = (json_number(values, key, where) for key in keys.values() if key is not None)
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    elif matrix is not None:
        count = sum(len(x) if isinstance(x, list) else 1 for x in values[matrix])
        camera = _from_numbers(path, json_numbers(values[matrix], count, f"{path}: {matrix}").tolist())
        if camera is None or (count == 4 and isinstance(values[matrix][0], list)):
            raise RecordingError(f"{path}: {matrix}: expected a 3x3 or 4x4 matrix or fx fy cx cy, got {count} numbers")
        K = camera.K
    else:
        return None
    sizes = [first(names) for names in SIZES.values()]
    size = None
    if None not in sizes:
        width, height = (json_number(values, key, where) for key in sizes if key is not None)
        if not (0 < width < 1e6 and 0 < height < 1e6):
            raise RecordingError(f"{path}: expected an image size in pixels, got {width:g}x{height:g}")
        size = int(width), int(height)
    scale = first(SCALES)
    depth_scale = None
    if scale is not None:
        depth_scale = json_number(values, scale, where)
        if depth_scale <= 0:
            raise RecordingError(f"{path}: {scale}: expected a positive number, got {depth_scale:g}")
        depth_scale = 1.0 / depth_scale if depth_scale < 1 else depth_scale  # metres a unit, or units a metre
    return CameraFile(path, K, size, distortion_of(values, where), depth_scale)


def distortion_of(values: dict[str, Any], where: str) -> tuple[float, ...]:
    """OpenCV's coefficients from plain names: k1, k2, p1, ... or a list.

    Raises
    ------
    RecordingError  if another name speaks of a distortion that is not zero: it is never left out in silence.
    """
    understood = {*COEFFICIENTS, *DISTORTION_NAMES}
    for name, value in values.items():
        if name not in understood and SPEAKS_OF_DISTORTION.search(name) and _is_something(value):
            raise RecordingError(f"{where}: {name}: this lens distortion is not understood; undistort the images first")
    listed = next((values[name] for name in DISTORTION_NAMES if isinstance(values.get(name), list)), None)
    if listed is not None:
        coefficients = json_numbers(listed, len(listed), f"{where}: distortion")
    else:
        coefficients = np.array([json_number(values, name, where, 0.0) for name in COEFFICIENTS])
    if not coefficients.any():
        return ()
    shortest = next((n for n in DISTORTION_LENGTHS if n and n >= len(np.trim_zeros(coefficients, "b"))), None)
    if shortest is None:
        raise RecordingError(f"{where}: expected at most 14 coefficients, got {len(coefficients)}")
    return tuple(np.pad(coefficients, (0, 14))[:shortest].tolist())


def _is_something(value: Any) -> bool:
    if isinstance(value, list):
        return any(_is_something(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool) and value != 0


def _upright(K: np.ndarray) -> np.ndarray:
    """Row by row, where it was written column by column."""
    return K.T if K[0, 2] == 0 and K[1, 2] == 0 and (K[2, 0] != 0 or K[2, 1] != 0) else K
