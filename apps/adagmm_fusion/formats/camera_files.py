"""A camera's intrinsics in whatever small file people keep them.

.txt, .csv, .npy    3x3, 3x4 or 4x4 matrix, or fx fy cx cy, or width height fx fy cx cy, or lines "fx: 525", or a table
                    with the headings fx, fy, cx, cy
.json               anywhere in it: fx (fl_x, focal_x), fy, cx (ppx), cy (ppy), or a matrix called K, camera_matrix,
                    intrinsic_matrix, intrinsics, cam_K, row by row or, as Open3D writes it, column by column;
                    width (w), height (h), or image_size, resolution; k1 k2 p1 p2 k3 or a list distortion, dist_coeffs,
                    D, of OpenCV's lens model; depth_scale or depth_units. Two cameras are told apart by their names;
                    see camera_fields.py
.yaml, .yml, .xml   as ROS, OpenCV or ORB-SLAM write them; see rigs/importing.py

A file's name may say the image size, as in intrinsics_640x480.txt.
"""

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.files.input_file import read_input_text, visible
from adagmm_fusion.files.json_file import json_number, json_numbers, read_json
from adagmm_fusion.formats.camera_fields import (
    DEPTH,
    MATRICES,
    NUMBER,
    SCALARS,
    SHAPES,
    SIZES,
    camera_fields,
    is_something,
)
from adagmm_fusion.formats.options import intrinsics_from_matrix
from adagmm_fusion.formats.text_table import with_decimal_points
from adagmm_fusion.frames.intrinsics_checks import LOOK_EXCHANGED, look_exchanged
from adagmm_fusion.frames.rgbd import DISTORTION_LENGTHS, PinholeIntrinsics
from adagmm_fusion.rigs.depth_units import depth_scale_of
from adagmm_fusion.rigs.importing import (
    COEFFICIENTS,
    DISTORTION_NAMES,
    HEIGHTS,
    SPEAKS_OF_DISTORTION,
    WIDTHS,
    read_calibration,
    without_rounding,
)
from adagmm_fusion.rigs.lens_models import other_lens_model
from adagmm_o3d.errors import InputError

SUFFIXES = (".txt", ".csv", ".npy", ".json", ".yaml", ".yml", ".xml")
FILE_NAME = re.compile(r"intrinsic|calib|camera|(^|[^a-z])(k|cam|cam_params)([^a-z]|$)", re.IGNORECASE)
# Such a name is of where the camera is.
OF_POSES = re.compile(r"pose|traj|ground_?truth|odom|extrinsic|c2w|w2c|to_?world|to_?cam", re.IGNORECASE)
FOLDER_NAME = re.compile(r"intrinsic|calib|camera", re.IGNORECASE)
ORB_SLAMS = re.compile(r"^Camera1?\.fx[ \t]*:", re.MULTILINE)
# An image size, as in 640x480.
IN_NAME = re.compile(r"(?<!\d)(\d{2,5}) ?[xX] ?(\d{2,5})(?!\d)")
# Names with their values, several on a line.
NAMED = re.compile(rf"[A-Za-z_]\w*(?:\s*[:=]\s*|\s+){NUMBER.pattern}")
SEVERAL = re.compile(rf"(?:{NAMED.pattern}[\s,;]*){{2,}}")
FEW_VALUES = "a 3x3 or 4x4 matrix or fx fy cx cy"
EXPECTED = f"{FEW_VALUES}, or width height fx fy cx cy, or names (fx, fy, cx, cy) with their values"
# A principal point further from the middle than these shares of the image is rather that of another image size.
NEAR_MIDDLE = (0.35, 0.65)
OTHER_SIZE = "look like those of another image size"


@dataclass(frozen=True, eq=False)
class CameraFile:
    """What a file says of a camera: the matrix K (3, 3), the image's (width, height), the lens distortion and the depth
    units per metre; None where it does not say.

    role : COLOR or DEPTH, where the file says whose it is.    depth_camera : the depth camera, where the file has both.
    """

    path: Path
    K: np.ndarray
    size: tuple[int, int] | None = None
    distortion: tuple[float, ...] = ()
    depth_scale: float | None = None
    role: str | None = None
    depth_camera: "CameraFile | None" = None

    def intrinsics(self, sizes: tuple[tuple[int, int], ...]) -> PinholeIntrinsics:
        """For the size that the file names, else for that of `sizes` whose middle is next to the principal point."""
        k = intrinsics_from_matrix(self.K, self._size(sizes), self.path)
        try:
            return PinholeIntrinsics(k.width, k.height, k.fx, k.fy, k.cx, k.cy, self.distortion)
        except InputError as problem:
            raise RecordingError(f"{self.path}: {problem}") from problem

    def doubt(self, sizes: tuple[tuple[int, int], ...]) -> str | None:
        """What to say where cx and cy look exchanged, or where the file names no size and the principal point is far
        from the image's middle, or None."""
        width, height = self._size(sizes)
        fx, fy, cx, cy = (float(self.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        if look_exchanged(width, height, cx, cy):
            return (
                f"{self.path.name}: cx {cx:g} cy {cy:g} {LOOK_EXCHANGED}, for images of {width}x{height}; "
                "if they are, exchange them in the file"
            )
        if self.size is not None:
            return None
        low, high = NEAR_MIDDLE
        if low <= cx / width <= high and low <= cy / height <= high:
            return None
        return (
            f"{self.path.name}: fx {fx:g} fy {fy:g} cx {cx:g} cy {cy:g} {OTHER_SIZE} than "
            f"{width}x{height}; say which, as width and height in intrinsics.json"
        )

    def _size(self, sizes: tuple[tuple[int, int], ...]) -> tuple[int, int]:
        if self.size is not None:
            return self.size
        return min(sizes, key=lambda s: abs(self.K[0, 2] / s[0] - 0.5) + abs(self.K[1, 2] / s[1] - 0.5))


def find_camera_files(folder: Path) -> list[Path]:
    """The files that by their names may hold a calibration, in the folder and in those below that are named so; and
    ORB-SLAM's settings, whatever they are called."""
    places = [folder, *(p for p in visible(folder.iterdir()) if p.is_dir() and FOLDER_NAME.search(p.name))]
    found = []
    for place in places:
        for path in visible(place.iterdir()):
            if path.suffix.lower() not in SUFFIXES:
                continue
            named = FILE_NAME.search(path.stem if place == folder else f"k_{path.stem}")
            if named or (place == folder and _is_orb_slams(path)):
                found.append(inside(folder, str(path.relative_to(folder)), str(folder)))
    of_poses = {path for path in found if OF_POSES.search(path.name) and "intrinsic" not in path.name.lower()}
    return [path for path in found if path not in of_poses and not path.is_dir()]


def _is_orb_slams(path: Path) -> bool:
    if path.suffix.lower() not in (".yaml", ".yml"):
        return False
    try:
        return ORB_SLAMS.search(read_input_text(path, RecordingError)) is not None
    except RecordingError:  # then it is not by its contents that anybody would look into it
        return False


def read_camera_file(path: Path) -> CameraFile | None:
    """What a file says of a camera, the colour camera where it has two, or None if it is about something else.

    Raises
    ------
    RecordingError  if it cannot be read, has several cameras and does not say whose they are, or speaks of a lens
        distortion that is not understood.
    """
    suffix = path.suffix.lower()
    if suffix in (".yaml", ".yml", ".xml"):
        return _from_ros_or_opencv(path)
    if suffix == ".json":
        return _sized_by_name(_from_document(path, read_json(path)))
    if suffix == ".npy":
        from adagmm_fusion.files.image_files import read_depth

        return _sized_by_name(_from_numbers(path, read_depth(path).astype(np.float64).ravel().tolist()))
    lines = read_input_text(path, RecordingError)[:100_000].splitlines()
    text = "\n".join(map(with_decimal_points, lines))
    named = _named_values(path, text)
    if named:
        return _sized_by_name(_from_document(path, named))
    if re.search(r"[A-Za-z]", re.sub(r"#.*|[eE](?=[-+]?\d)", "", text)):
        return None
    return _sized_by_name(_from_numbers(path, [float(word) for word in NUMBER.findall(re.sub(r"#.*", "", text))]))


def _named_values(path: Path, text: str) -> dict[str, Any]:
    """The values of lines such as "fx: 525", in objects by the [section] above them, or of a table with headings."""
    rows = [line for line in (re.sub(r"#.*", "", line).strip() for line in text.splitlines()) if line]
    rows = [part for row in rows for part in (SEVERAL.fullmatch(row) and NAMED.findall(row)) or [row]]
    table = [re.split(r"[,;\s]+", row.strip(",; ")) for row in rows]
    if len(table) > 1 and len(table[0]) > 1 and all(re.fullmatch(r"[A-Za-z_]\w*", word) for word in table[0]):
        if len({tuple(row) for row in table[1:]}) == 1 and len(table[1]) == len(table[0]):
            return dict(zip(table[0], table[1], strict=True))
        return {}
    named: dict[str, Any] = {}
    section = named
    for row in rows:
        if heading := re.fullmatch(r"\[\s*([A-Za-z_][\w .-]*?)\s*\]", row):
            section = named.setdefault(heading[1], {})
        elif found := re.fullmatch(rf"([A-Za-z_][\w.]*)\s*[:=,\s]\s*({NUMBER.pattern})\s*;?", row):
            if section.get(found[1], found[2]) != found[2]:
                raise RecordingError(
                    f"{path}: {found[1]} is there twice, {section[found[1]]} and {found[2]}; keep the colour camera's"
                )
            section[found[1]] = found[2]
    return named


def _sized_by_name(camera: CameraFile | None) -> CameraFile | None:
    """With the image size that the file's name states, as in intrinsics_640x480.txt, where the file has none."""
    found = camera and IN_NAME.search(camera.path.stem)
    if camera is None or camera.size is not None or not found:
        return camera
    return replace(camera, size=(int(found[1]), int(found[2])))


def _from_numbers(path: Path, numbers: list[float]) -> CameraFile | None:
    if not all(math.isfinite(x) for x in numbers):
        raise RecordingError(f"{path}: expected finite numbers")
    if len(numbers) in (9, 12, 16):
        rows, columns = {9: (3, 3), 12: (3, 4), 16: (4, 4)}[len(numbers)]
        matrix = np.reshape(numbers, (rows, columns))
        if columns == 4 and matrix[:3, 3].any():
            raise RecordingError(
                f"{path}: expected a camera matrix, its fourth column zero, got {matrix[:3, 3].tolist()} there; "
                "is it a pose or a projection matrix?"
            )
        return CameraFile(path, without_rounding(_upright(matrix[:3, :3])))
    size = None
    if len(numbers) == 6:
        width, height, *numbers = numbers
        middle = numbers[2] / width if width else 0.0, numbers[3] / height if height else 0.0
        if width % 1 or height % 1 or not (width > 0 < height) or not all(0.2 < x < 0.8 for x in middle):
            return None
        size = int(width), int(height)
    if len(numbers) == 4:
        fx, fy, cx, cy = numbers
        return CameraFile(path, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), size)
    return None


def _from_ros_or_opencv(path: Path) -> CameraFile | None:
    try:
        camera = read_calibration(path)
    except RigError as problem:
        raise RecordingError(str(problem)) from problem
    return _sized_by_name(CameraFile(path, camera.K, camera.size, camera.distortion, camera.depth_scale))


def _from_document(path: Path, document: Any) -> CameraFile | None:
    """The colour camera of nested objects, or their only one."""
    cameras: list[CameraFile] = []
    for fields in camera_fields(document, str(path)):
        camera = _from_values(path, fields.values)
        if camera is not None:
            cameras.append(replace(camera, role=fields.role))
    if len(cameras) < 2:
        return cameras[0] if cameras else None
    color, depth = sorted(cameras, key=lambda camera: camera.role == DEPTH)
    return replace(color, depth_camera=depth)


def _from_values(path: Path, values: dict[str, Any]) -> CameraFile | None:
    def first(names: tuple[str, ...]) -> str | None:
        return next((name for name in names if name in values), None)

    where, size = str(path), None
    keys = {name: first(names) for name, names in SCALARS.items()}
    matrix = next((name for name in MATRICES if isinstance(values.get(name), list)), None)
    if all(keys.values()):
        fx, fy, cx, cy = (json_number(values, key, where) for key in keys.values() if key is not None)
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    elif matrix is not None:
        count = sum(len(x) if isinstance(x, list) else 1 for x in values[matrix])
        camera = _from_numbers(path, json_numbers(values[matrix], count, f"{path}: {matrix}").tolist())
        if camera is None or (count == 4 and isinstance(values[matrix][0], list)):
            raise RecordingError(f"{path}: {matrix}: expected {FEW_VALUES}, got {count} numbers")
        K, size = camera.K, camera.size
    else:
        return None
    distortion = distortion_of(values, where)
    if problem := other_lens_model(values, bool(distortion)):
        raise RecordingError(f"{where}: {problem}")
    return CameraFile(
        path, K, _size_of(values, where) or size, distortion, depth_scale_of(values, where, RecordingError)
    )


def _size_of(values: dict[str, Any], where: str) -> tuple[int, int] | None:
    """(width, height) under whatever names; None where there are none."""
    found = [next((name for name in names if name in values), None) for names in (WIDTHS, HEIGHTS)]
    width, height = (None if name is None else json_number(values, name, where) for name in found)
    if width is None and height is None:
        name = next((name for name in (*SIZES, *SHAPES) if values.get(name) is not None), None)
        if name is None:
            return None
        value = values[name]
        if isinstance(value, str) and (text := IN_NAME.search(value)):
            value = [float(text[1]), float(text[2])]
        if name in SHAPES and isinstance(value, list):  # rows and columns, as arrays have them
            value = value[1::-1]
        width, height = json_numbers(value, 2, f"{where}: {name}")
    if width is None or height is None:
        raise RecordingError(f"{where}: expected the image's width and height, got only one of them; write both")
    if not (0 < width < 1e6 and 0 < height < 1e6):
        raise RecordingError(f"{where}: expected an image size in pixels, got {width:g}x{height:g}")
    return int(width), int(height)


def distortion_of(values: dict[str, Any], where: str) -> tuple[float, ...]:
    """OpenCV's coefficients from plain names: k1, k2, p1, ... or a list.

    Raises
    ------
    RecordingError  if another name speaks of a distortion that is not zero: it is never left out in silence.
    """
    understood = {*COEFFICIENTS, *(name for name in DISTORTION_NAMES if isinstance(values.get(name), list))}
    for name, value in values.items():
        if name not in understood and SPEAKS_OF_DISTORTION.search(name) and is_something(value):
            raise RecordingError(f"{where}: {name}: this lens distortion is not understood; undistort the images first")
    listed = next((values[name] for name in DISTORTION_NAMES if isinstance(values.get(name), list)), None)
    if listed is not None:
        count = sum(len(x) if isinstance(x, list) else 1 for x in listed)
        coefficients = json_numbers(listed, count, f"{where}: distortion")
    else:
        coefficients = np.array([json_number(values, name, where, 0.0) for name in COEFFICIENTS])
    if not coefficients.any():
        return ()
    shortest = next((n for n in DISTORTION_LENGTHS if n and n >= len(np.trim_zeros(coefficients, "b"))), None)
    if shortest is None:
        raise RecordingError(f"{where}: expected at most 14 coefficients, got {len(coefficients)}")
    return tuple(np.pad(coefficients, (0, 14))[:shortest].tolist())


def _upright(K: np.ndarray) -> np.ndarray:
    """Row by row, where it was written column by column."""
    return K.T if K[0, 2] == 0 and K[1, 2] == 0 and (K[2, 0] != 0 or K[2, 1] != 0) else K
