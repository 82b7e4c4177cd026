"""COLMAP's text model, a folder with cameras.txt and images.txt, in which every camera took one image: a rig.

    cameras.txt    CAMERA_ID MODEL WIDTH HEIGHT PARAMS...
    images.txt     IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, world to camera; each followed by a line of points

The sensors are called as the images. COLMAP's model has no unit of its own, so the length of one of its units in metres
has to be known. Its pixels' corners are whole numbers, ours their centres.
"""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.input_file import read_input_text
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

# For each model, which of its parameters are fx, fy, cx, cy and OpenCV's coefficients.
MODELS = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3, None, None, None)),
    "RADIAL": ((0, 0, 1, 2), (3, 4, None, None)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8, 9, 10, 11)),
}
PIXEL_CENTRE = 0.5


def read_colmap(folder: Path, metres_per_unit: float) -> dict[str, ImportedSensor]:
    """The cameras by the stems of their images' names, in the first one's frame.

    Raises
    ------
    RigError  naming file and line, or that a camera took several images, as a moving one does.
    """
    cameras = dict(_camera(line, where) for where, line in _lines(folder / "cameras.txt"))
    sensors: dict[str, ImportedSensor] = {}
    used: set[str] = set()
    T_rig_world = None
    for where, line in list(_lines(folder / "images.txt", blank=True))[::2]:
        words = line.split(maxsplit=9)
        if len(words) != 10 or words[8] not in cameras:
            raise RigError(f"{where}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME of a known camera")
        name = Path(words[9]).stem
        if words[8] in used or name in sensors:
            raise RigError(f"{where}: camera {words[8]} or name {name!r} is there twice; a rig has one image of each")
        used.add(words[8])
        w, x, y, z, *t = _numbers(words[1:8], where)
        T = np.eye(4)
        try:
            T[:3, :3], T[:3, 3] = Rotation.from_quat((x, y, z, w)).as_matrix(), metres_per_unit * np.array(t)
            T_camera_world = checked_rigid_transformation(T, "pose")
        except (InputError, ValueError) as problem:
            raise RigError(f"{where}: {problem}") from problem
        T_rig_world = T_camera_world if T_rig_world is None else T_rig_world
        sensors[name] = ImportedSensor(cameras[words[8]], T_rig_world @ se_inverse(T_camera_world))
    return sensors


def _lines(path: Path, blank: bool = False) -> list[tuple[str, str]]:
    """("file:line", the line) without comments; empty ones, an image without points, with `blank`."""
    try:
        text = read_input_text(path, RecordingError)
    except RecordingError as problem:
        raise RigError(str(problem)) from problem
    lines = [(f"{path}:{n}", line) for n, line in enumerate(text.splitlines(), 1) if not line.startswith("#")]
    return [(where, line) for where, line in lines if blank or line.strip()]


def _numbers(words: list[str], where: str) -> list[float]:
    try:
        numbers = [float(word) for word in words]
    except ValueError as problem:
        raise RigError(f"{where}: expected numbers: {problem}") from problem
    if not np.isfinite(numbers).all():
        raise RigError(f"{where}: expected finite numbers")
    return numbers


def _camera(line: str, where: str) -> tuple[str, PinholeIntrinsics]:
    words = line.split()
    if len(words) < 5 or words[1] not in MODELS:
        known = ", ".join(MODELS)
        raise RigError(f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS with one of {known}; undistort first")
    pinhole, lens = MODELS[words[1]]
    width, height, *parameters = _numbers(words[2:], where)
    if len(parameters) != 1 + max(*pinhole, *(i for i in lens if i is not None)):
        raise RigError(f"{where}: {words[1]}: got {len(parameters)} parameters")
    fx, fy, cx, cy = (parameters[i] for i in pinhole)
    distortion = tuple(0.0 if i is None else parameters[i] for i in lens)
    try:
        return words[0], PinholeIntrinsics(
            int(width), int(height), fx, fy, cx - PIXEL_CENTRE, cy - PIXEL_CENTRE, distortion if any(distortion) else ()
        )
    except InputError as problem:
        raise RigError(f"{where}: {problem}") from problem
