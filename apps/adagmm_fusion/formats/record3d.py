"""Record3D (iOS), shared as .r3d: one phone with LiDAR or TrueDepth.

The file is a ZIP archive; a folder with one such file, or with what it holds, is read as well.

    metadata          JSON: w, h, dw, dh (sizes of colour and depth; of older files 256x192), K (9 numbers, column by
                      column, of the colour image), fps, poses: [qx, qy, qz, qw, x, y, z] a frame, camera to world in
                      ARKit's axes, metres; newer ones: perFrameIntrinsicCoeffs: [fx, fy, cx, cy] a frame,
                      frameTimestamps [s]
    rgbd/0.jpg        colour
    rgbd/0.depth      LZFSE of float32 (dh, dw), metres, NaN or 0 none
    rgbd/0.conf       optional, LZFSE of uint8 (dh, dw): 0, 1 or 2; where it is 0 the depth is left out

Source: Record3D's own documentation of the format.
"""

import os
import zipfile
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import decoded_color, inside
from adagmm_fusion.files.input_file import MAX_BYTES, check_input, is_given, read_input, visible
from adagmm_fusion.files.json_file import json_number, json_numbers, json_object, parse_json
from adagmm_fusion.files.lzfse import decoded_lzfse
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.formats.phone_depth import ARKIT_FROM_RDF, kept_where_confident
from adagmm_fusion.formats.text_table import parse_quaternion_pose
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.errors import InputError

NAME = "record3d"
SUMMARY = "Record3D .r3d, or a folder with one or with what it holds"
SENSOR = "phone"
MAX_SIZE = 10_000


def matches(path: Path) -> bool:
    if path.is_file():
        return path.suffix.lower() == ".r3d"
    return len(visible(path.glob("*.r3d"))) == 1 or (is_given(path / "metadata") and (path / "rgbd").is_dir())


def read(path: Path, options: ReadOptions) -> Recording:
    place = path if not path.is_dir() else next(iter(visible(path.glob("*.r3d"))), path)
    if place != path:
        place = inside(path, place.name, str(path))
    where = f"{place}: metadata"
    metadata = json_object(parse_json(_content(place, "metadata"), Path(where)), where)
    w, h = (int(json_number(metadata, name, where)) for name in ("w", "h"))
    lidar = (192, 256) if h > w else (256, 192)  # older files do not say it
    dw, dh = (int(json_number(metadata, name, where, size)) for name, size in zip(("dw", "dh"), lidar, strict=True))
    if not all(0 < size <= MAX_SIZE for size in (w, h, dw, dh)):
        raise RecordingError(f"{where}: expected sizes w, h, dw, dh in pixels, got {w}, {h}, {dw}, {dh}")
    poses = metadata.get("poses")
    if not isinstance(poses, list) or not poses:
        raise RecordingError(f"{where}: poses: expected a list of poses, got none")
    intrinsics = _intrinsics(metadata, w, h, where)
    stamps, fps = metadata.get("frameTimestamps"), json_number(metadata, "fps", where, 30.0)
    frames = []
    for i, values in enumerate(poses):
        T = parse_quaternion_pose(_translation_first(json_numbers(values, 7, f"{where}: poses[{i}]")), where)
        if isinstance(stamps, list) and len(stamps) == len(poses):
            seconds = float(json_numbers(stamps[i], 1, f"{where}: frameTimestamps[{i}]")[0])
        else:
            seconds = i / fps if fps > 0 else float(i)
        color = partial(_color, place, i)
        depth = partial(_depth, place, i, (dh, dw))
        frames.append(
            ListedFrame(f"{i:06d}", color, depth, intrinsics(i), 1.0, T @ ARKIT_FROM_RDF, seconds, where=place)
        )
    return recording_of_frames(path, NAME, SENSOR, frames, options)


def _translation_first(pose: np.ndarray) -> list[float]:
    return [*pose[4:], *pose[:4]]


def _intrinsics(metadata: dict[str, Any], w: int, h: int, where: str) -> Callable[[int], PinholeIntrinsics]:
    """Of the frame with a number."""
    each = metadata.get("perFrameIntrinsicCoeffs")
    if not isinstance(each, list) or len(each) != len(metadata["poses"]):
        K = json_numbers(metadata.get("K"), 9, f"{where}: K")
        each = [[K[0], K[4], K[6], K[7]]] * len(metadata["poses"])

    def of_frame(i: int) -> PinholeIntrinsics:
        fx, fy, cx, cy = json_numbers(each[i], 4, f"{where}: perFrameIntrinsicCoeffs[{i}]")
        try:
            return PinholeIntrinsics(w, h, fx, fy, cx, cy)
        except InputError as problem:
            raise RecordingError(f"{where}: {problem}") from problem

    return of_frame


def _color(place: Path, i: int) -> np.ndarray:
    return decoded_color(_content(place, f"rgbd/{i}.jpg"), Path(f"{place}: rgbd/{i}.jpg"))


def _depth(place: Path, i: int, shape: tuple[int, int]) -> np.ndarray:
    depth = _array(place, f"rgbd/{i}.depth", shape, np.dtype("<f4"))
    confidence = _content(place, f"rgbd/{i}.conf", optional=True)
    if not confidence:
        return depth
    return kept_where_confident(depth, _array(place, f"rgbd/{i}.conf", shape, np.dtype("u1")), place)


def _array(place: Path, name: str, shape: tuple[int, int], dtype: np.dtype) -> np.ndarray:
    size = shape[0] * shape[1] * dtype.itemsize
    data = decoded_lzfse(_content(place, name), size, f"{place}: {name}")
    return np.frombuffer(data, dtype).reshape(shape)


def _content(place: Path, name: str, *, optional: bool = False) -> bytes:
    """The bytes of a member of the archive, or of the folder; none where it is missing and optional."""
    if place.is_dir():
        path = inside(place, name, str(place))
        return b"" if optional and not is_given(path) else read_input(path, RecordingError, missing="it is missing")
    check_input(place, RecordingError)
    try:
        status = place.stat()
        archive = _open(place, status.st_mtime_ns, status.st_size, os.getpid())
        try:
            member = archive.getinfo(name)
        except KeyError:
            if optional:
                return b""
            raise RecordingError(f"{place}: {name}: is missing in it; share it from Record3D again") from None
        if member.file_size > MAX_BYTES:
            raise RecordingError(f"{place}: {name}: expected at most {MAX_BYTES >> 20} MiB")
        return archive.read(member)
    except RecordingError:
        raise
    except Exception as problem:  # zipfile raises whatever the damage leads to
        raise RecordingError(f"{place}: {name}: the archive is damaged or cut off: {problem}") from problem


@lru_cache(maxsize=4)
def _open(place: Path, modified_ns: int, size: int, process: int) -> zipfile.ZipFile:
    """An archive whose list of members is read once, not for each of them; a forked process opens its own."""
    return zipfile.ZipFile(place)
