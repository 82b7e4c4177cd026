"""Which of a folder's calibration files is the colour camera's and which the depth camera's, and where they are.

Of several files for one camera those that say the same count once; else that which is for the images' size. Where that
does not decide, nothing is guessed.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.files.input_file import visible
from adagmm_fusion.formats.camera_fields import BOTH, COLOR, DEPTH, role_of
from adagmm_fusion.formats.camera_files import EXPECTED, SUFFIXES, CameraFile, find_camera_files, read_camera_file
from adagmm_fusion.formats.text_table import parse_pose, read_matrix
from adagmm_fusion.frames.one_grid import scaled_intrinsics
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

DEPTH_TO_COLOR = re.compile(r"depth_?(2|to)_?(colou?r|rgb)|T_(colou?r|rgb)_depth", re.IGNORECASE)
COLOR_TO_DEPTH = re.compile(r"(colou?r|rgb)_?(2|to)_?depth|T_depth_(colou?r|rgb)", re.IGNORECASE)
# aligned_depth_to_color/camera_info.yaml is a camera's, and not where it is.
OF_ONE_CAMERA = re.compile(r"intrinsic|camera_?info|aligned", re.IGNORECASE)
MATRIX_SUFFIXES = (".txt", ".csv")
# Two files say the same of a camera up to these shares of the focal length and pixels.
SAME_SHARE, SAME_PX = 2e-3, 1.0
# The two cameras of one depth sensor are nearer to each other than this [m].
MAX_BASELINE_M = 5.0


@dataclass(frozen=True, eq=False)
class FolderCameras:
    """The colour camera's calibration, or the only one; the depth camera's and T_color_depth (4, 4) [m] where depth is
    to be registered by them; the depth units a metre. None where the folder does not say.

    not_understood : what to say of files that by their names hold a calibration, and do not.
    """

    color: CameraFile | None = None
    depth: CameraFile | None = None
    T_color_depth: np.ndarray | None = None
    depth_scale: float | None = None
    notes: tuple[str, ...] = ()
    not_understood: str = ""


def find_cameras(folder: Path, color_size: tuple[int, int], depth_size: tuple[int, int]) -> FolderCameras:
    """The calibration of a folder whose images have these sizes (width, height).

    Raises
    ------
    RecordingError  naming the file or files, if one cannot be used, or two do not agree.
    """
    by_role: dict[str | None, list[CameraFile]] = {COLOR: [], DEPTH: [], None: []}
    unread: list[Path] = []
    for path in find_camera_files(folder):
        if _is_between(path.stem):
            continue
        camera = read_camera_file(path)
        if camera is None:
            unread.append(path)
            continue
        role = role_of(path.stem) or (role_of(path.parent.name) if path.parent != folder else None)
        if role == DEPTH and camera.depth_camera is not None:
            camera = camera.depth_camera
        by_role[camera.role if role in (None, BOTH) else role].append(camera)
    everything = [camera for cameras in by_role.values() for camera in cameras]
    notes: list[str] = []
    color = _chosen(by_role[COLOR] or by_role[None], color_size, notes)
    depth = _chosen(by_role[DEPTH], depth_size, notes)
    if color is None:
        color, depth = depth, None
    between, T = _between(folder)
    if color is not None and color.depth_camera is not None and depth is None:
        if T is not None:
            depth = color.depth_camera
        else:
            notes.append(
                f"{color.path.name}: the depth camera's intrinsics are not used: depth is taken as registered to the "
                "colour image; if it is not, add depth_to_color.txt (4x4, metres)"
            )
    if between is not None and T is None and depth is not None:
        raise RecordingError(
            f"{between}: expected where the depth camera is as a 4x4 matrix in metres in a .txt file, got "
            f"{between.suffix}; write it as {between.stem}.txt"
        )
    if between is not None and color is not None and depth is None:
        notes.append(
            f"{between.name} is not used: depth is taken as registered to the colour image; if it is not, add the "
            "depth camera's intrinsics as depth_intrinsics.txt, and this as depth_to_color.txt (4x4, metres)"
        )
    for camera, sizes in ((color, (color_size, depth_size)), (depth, (depth_size,))):
        if camera is not None and (doubt := camera.doubt(sizes)) is not None:
            notes.append(doubt)
    names = ", ".join(str(path.relative_to(folder)) for path in unread[:3])
    if unread:
        notes.append(f"not understood as a calibration and not used: {names}")
    said = f"; {names}: not understood, expected {EXPECTED}" if unread else ""
    return FolderCameras(color, depth, T, _depth_scale(everything), tuple(notes), said)


def _chosen(cameras: Sequence[CameraFile], size: tuple[int, int], notes: list[str]) -> CameraFile | None:
    """The one for images of this size, of files that are all for one camera."""
    ranked = sorted(cameras, key=lambda camera: camera.size != size)
    if not ranked or all(_same(ranked[0], camera, size) for camera in ranked):
        return ranked[0] if ranked else None
    exact = [camera for camera in ranked if camera.size == size]
    fitting = exact or [camera for camera in ranked if camera.size is None and camera.doubt((size,)) is None]
    if not fitting or not all(_same(fitting[0], camera, size) for camera in fitting):
        one = (fitting or ranked)[0]
        other = next(camera for camera in (fitting or ranked) if not _same(one, camera, size))
        raise RecordingError(
            f"{one.path} and {other.path.name}: two different calibrations for {size[0]}x{size[1]} images, fx "
            f"{one.K[0, 0]:g} and {other.K[0, 0]:g}; keep the true one, or name them by the camera: color, depth"
        )
    others = ", ".join(camera.path.name for camera in ranked if camera not in fitting)
    notes.append(f"intrinsics are those of {fitting[0].path.name}, which fit {size[0]}x{size[1]} images; not {others}")
    return fitting[0]


def _same(one: CameraFile, other: CameraFile, size: tuple[int, int]) -> bool:
    try:
        a, b = (scaled_intrinsics(camera.intrinsics((size,)), size) for camera in (one, other))
    except InputError:
        return one is other
    focal = all(abs(p - q) <= SAME_SHARE * p for p, q in ((a.fx, b.fx), (a.fy, b.fy)))
    return focal and max(abs(a.cx - b.cx), abs(a.cy - b.cy)) <= SAME_PX and a.distortion == b.distortion


def _depth_scale(cameras: Sequence[CameraFile]) -> float | None:
    cameras = [part for camera in cameras for part in (camera, camera.depth_camera) if part is not None]
    said = [(camera.path, camera.depth_scale) for camera in cameras if camera.depth_scale is not None]
    for path, scale in said:
        if abs(scale - said[0][1]) > 1e-6 * scale:
            raise RecordingError(
                f"{said[0][0]} and {path.name}: expected one depth scale, got {said[0][1]:g} and {scale:g} units a "
                "metre; keep the true one"
            )
    return said[0][1] if said else None


def _is_between(name: str) -> bool:
    if OF_ONE_CAMERA.search(name):
        return False
    return DEPTH_TO_COLOR.search(name) is not None or COLOR_TO_DEPTH.search(name) is not None


def _between(folder: Path) -> tuple[Path | None, np.ndarray | None]:
    """The file that says where the depth camera is, and T_color_depth, if it is a matrix."""
    found = [path for path in (*visible(folder.glob("*")), *visible(folder.glob("*/*.txt"))) if _is_between(path.stem)]
    found = [path for path in found if path.suffix.lower() in SUFFIXES and not path.is_dir()]
    for path in sorted(found, key=lambda path: path.suffix.lower() not in MATRIX_SUFFIXES):
        path = inside(folder, str(path.relative_to(folder)), str(folder))
        if path.suffix.lower() not in MATRIX_SUFFIXES:
            return path, None
        T = parse_pose(read_matrix(path, 4, 4), str(path))
        baseline = float(np.linalg.norm(T[:3, 3]))
        if baseline > MAX_BASELINE_M:
            raise RecordingError(
                f"{path}: expected metres between the colour and the depth camera, got {baseline:g}, which looks like "
                "millimetres; divide the translation by 1000"
            )
        return path, T if DEPTH_TO_COLOR.search(path.stem) else se_inverse(T)
    return None, None
