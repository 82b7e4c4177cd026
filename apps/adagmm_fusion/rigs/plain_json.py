"""One camera's intrinsics in plain JSON, as RealSense and Orbbec tools write them; see formats/camera_files.py."""

from pathlib import Path

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.input_file import read_input
from adagmm_fusion.formats.camera_fields import COLOR, DEPTH, role_of
from adagmm_fusion.formats.camera_files import read_camera_file
from adagmm_fusion.rigs.importing import ImportedCamera

OPENCV_MARK = b"opencv-matrix"


def read_plain_json(path: Path, size: tuple[int, int] | None, sensor: str) -> tuple[ImportedCamera, str | None] | None:
    """The camera, and what is to be said of it; None if the file is not called .json, is OpenCV's, or has no focal
    length by name.

    Parameters
    ----------
    size : (width, height) where the file has none.    sensor : its name, by which the depth camera's is taken of two.

    Raises
    ------
    RigError  naming the file and what is wrong.
    """
    if path.suffix.lower() != ".json" or OPENCV_MARK in read_input(path, RigError):
        return None
    try:
        camera = read_camera_file(path)
        if camera is None:
            return None
        note = None
        if camera.depth_camera is not None:
            role = role_of(sensor)
            camera = camera.depth_camera if role == DEPTH else camera
            if role not in (COLOR, DEPTH):
                note = f"{path}: it has a colour and a depth camera; {sensor} is the colour camera"
        if camera.size is None and size is None:
            raise RigError(f"{path}: the image size is not in it; give it with --size")
        intrinsics = camera.intrinsics((size,) if size is not None else ())
    except RecordingError as problem:
        raise RigError(str(problem)) from problem
    return ImportedCamera(intrinsics, depth_scale=camera.depth_scale), note
