"""Polycam's raw data (iOS, developer mode): one phone with LiDAR.

    keyframes/images/<id>.jpg      or corrected_images/, where Polycam has optimised the poses
    keyframes/cameras/<id>.json    or corrected_cameras/: width, height, fx, fy, cx, cy, t_00 ... t_23, row by row,
                                   camera to world in ARKit's axes (x right, y up, z backward), metres; timestamp [µs]
    keyframes/depth/<id>.png       16 bit, 256x192, millimetres, of the same view
    keyframes/confidence/<id>.png  optional, 8 bit; where it is 0 the depth is left out

The folder may also be keyframes/ itself. Depth is drawn out over the colour image. Source: Polycam's polyform.
"""

from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import inside
from adagmm_fusion.files.json_file import json_number, json_object, read_json
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions, listed_images, unpaired_notes
from adagmm_fusion.formats.phone_depth import ARKIT_FROM_RDF, MILLIMETRES_PER_METRE, confident_depth
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.errors import InputError

NAME = "polycam"
SUMMARY = "Polycam raw data (keyframes/images/, cameras/, depth/)"
SENSOR = "phone"
IMAGES = (("corrected_images", "corrected_cameras"), ("images", "cameras"))


def matches(folder: Path) -> bool:
    return _keyframes(folder) is not None


def read(folder: Path, options: ReadOptions) -> Recording:
    keyframes = _keyframes(folder)
    if keyframes is None:
        raise RecordingError(f"{folder}: expected keyframes/ with images/, cameras/ and depth/")
    images, cameras = _images_and_cameras(keyframes)
    colors = {path.stem: path for path in listed_images(keyframes / images, (".jpg", ".jpeg", ".png"))}
    depths = {path.stem: path for path in listed_images(keyframes / "depth", (".png",))}
    notes = unpaired_notes(colors, depths, keyframes)
    frames = []
    for name in sorted(colors.keys() & depths.keys()):
        where = str(keyframes)
        color, depth, camera, confidence = (
            inside(keyframes, relative, where)
            for relative in (
                f"{images}/{colors[name].name}",
                f"depth/{depths[name].name}",
                f"{cameras}/{name}.json",
                f"confidence/{name}.png",
            )
        )
        intrinsics, T_world_camera, seconds = _read_camera(camera)
        load = partial(confident_depth, depth, confidence)
        frames.append(
            ListedFrame(name, color, load, intrinsics, MILLIMETRES_PER_METRE, T_world_camera, seconds, where=depth)
        )
    return recording_of_frames(folder, NAME, SENSOR, frames, options, notes)


def _keyframes(folder: Path) -> Path | None:
    for place in (folder / "keyframes", folder):
        if (place / "depth").is_dir() and any((place / i).is_dir() and (place / c).is_dir() for i, c in IMAGES):
            return place
    return None


def _images_and_cameras(keyframes: Path) -> tuple[str, str]:
    return next((i, c) for i, c in IMAGES if (keyframes / i).is_dir() and (keyframes / c).is_dir())


def _read_camera(path: Path) -> tuple[PinholeIntrinsics, np.ndarray, float | None]:
    where = str(path)
    values = json_object(read_json(path), where)
    width, height, fx, fy, cx, cy = (
        json_number(values, name, where) for name in ("width", "height", "fx", "fy", "cx", "cy")
    )
    try:
        intrinsics = PinholeIntrinsics(int(width), int(height), fx, fy, cx, cy)
    except InputError as problem:
        raise RecordingError(f"{path}: {problem}") from problem
    T = np.eye(4)
    T[:3] = [[json_number(values, f"t_{row}{column}", where) for column in range(4)] for row in range(3)]
    seconds = json_number(values, "timestamp", where) / 1e6 if "timestamp" in values else None
    return intrinsics, parse_pose(T, where) @ ARKIT_FROM_RDF, seconds
