"""ScanNet scenes as its tools export them: one tablet with a Structure sensor.

    color/0.jpg                       of the colour camera, often finer than the depth
    depth/0.png                       16 bit, millimetres, 0 none, of the depth camera
    pose/0.txt                        4x4 camera to world, metres; of infinity where tracking was lost
    intrinsic/intrinsic_color.txt     4x4 or 3x3; here or in the folder itself
    intrinsic/intrinsic_depth.txt     alone it is both cameras', the images being resized to one size
    intrinsic/extrinsic_color.txt     optional, 4x4, as extrinsic_depth.txt: each camera to their common frame

Depth is registered to the colour image by the two calibrations. Source: Dai et al. 2017 and ScanNet's SensReader.
"""

from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import COLOR_SUFFIXES, inside, read_color, read_depth
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.formats.camera_files import CameraFile, read_camera_file
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions, listed_images, unpaired_notes
from adagmm_fusion.formats.pose_lists import read_pose_file
from adagmm_fusion.formats.text_table import parse_pose, read_matrix
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.lie import se_inverse

NAME = "scannet"
SUMMARY = "ScanNet export (color/, depth/, pose/, intrinsic/intrinsic_depth.txt)"
SENSOR = "camera"
DEPTH_SCALE = 1000.0


def matches(folder: Path) -> bool:
    has_folders = all((folder / name).is_dir() for name in ("color", "depth", "pose"))
    return has_folders and _file(folder, "intrinsic_depth.txt") is not None


def read(folder: Path, options: ReadOptions) -> Recording:
    colors, depths = (
        {
            path.stem: inside(folder, f"{kind}/{path.name}", str(folder))
            for path in listed_images(folder / kind, suffixes)
        }
        for kind, suffixes in (("color", COLOR_SUFFIXES), ("depth", (".png",)))
    )
    notes = unpaired_notes(colors, depths, folder)
    names = sorted(colors.keys() & depths.keys(), key=lambda name: (len(name), name))
    color, depth = _camera(folder, "intrinsic_color.txt"), _camera(folder, "intrinsic_depth.txt")
    if depth is None:
        raise RecordingError(f"{folder}: expected intrinsic/intrinsic_depth.txt, it is missing")
    sizes = read_color(colors[names[0]]).shape[1::-1], read_depth(depths[names[0]]).shape[::-1]
    of_depth = depth.intrinsics((sizes[1],))
    frames = [
        ListedFrame(
            name,
            colors[name],
            depths[name],
            of_depth if color is None else color.intrinsics((sizes[0],)),
            DEPTH_SCALE,
            _pose(folder, name),
            depth_intrinsics=None if color is None else of_depth,
            T_color_depth=None if color is None else _depth_to_color(folder),
        )
        for name in names
    ]
    return recording_of_frames(folder, NAME, SENSOR, frames, options, notes)


def _pose(folder: Path, name: str) -> np.ndarray | None:
    path = inside(folder, f"pose/{name}.txt", str(folder))
    return read_pose_file(path) if is_given(path) else None


def _file(folder: Path, name: str) -> Path | None:
    return next((path for path in (folder / "intrinsic" / name, folder / name) if is_given(path)), None)


def _camera(folder: Path, name: str) -> CameraFile | None:
    path = _file(folder, name)
    if path is None:
        return None
    path = inside(folder, str(path.relative_to(folder)), str(folder))
    camera = read_camera_file(path)
    if camera is None:
        raise RecordingError(f"{path}: expected a 4x4 or 3x3 camera matrix")
    return camera


def _depth_to_color(folder: Path) -> np.ndarray:
    """T_color_depth (4, 4)."""
    T = []
    for name in ("extrinsic_color.txt", "extrinsic_depth.txt"):
        path = _file(folder, name)
        T.append(np.eye(4) if path is None else parse_pose(read_matrix(path, 4, 4), str(path)))
    return se_inverse(T[0]) @ T[1]
