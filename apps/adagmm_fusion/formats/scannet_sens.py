"""ScanNet's .sens files: one scene as its sensor stream.

    uint32 version (4), uint64 length, name
    4x4 float32 each: intrinsics and extrinsics of the colour camera, then of the depth camera
    int32 compression of colour (1 PNG, 2 JPEG) and of depth (0 uint16, 1 zlib of uint16)
    uint32 width and height of colour, then of depth; float32 depth units per metre; uint64 number of frames
    a frame: 4x4 float32 camera to world; uint64 times of colour and depth [µs]; uint64 sizes; both images' data

All little endian. Depth is registered to the colour image by the two calibrations. A pose of infinity is one that
tracking lost. Source: ScanNet's SensReader.
"""

import os
import struct
import zlib
from functools import partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.depth_files import MAX_PIXELS
from adagmm_fusion.files.image_files import decoded_color, inside
from adagmm_fusion.files.input_file import check_input, visible
from adagmm_fusion.formats.listed_frames import ListedFrame, recording_of_frames
from adagmm_fusion.formats.options import ReadOptions, intrinsics_from_matrix
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.recordings.frame_sequence import Recording
from adagmm_o3d.lie import se_inverse

NAME = "sens"
SUMMARY = "ScanNet .sens file, or a folder with one"
SENSOR = "camera"
VERSION = 4
COLOR_KINDS, DEPTH_STORED, DEPTH_ZLIB = (1, 2), 0, 1
MAX_NAME = 10_000
FRAME_HEADER = struct.Struct("<16f4Q")


def matches(path: Path) -> bool:
    return path.suffix.lower() == ".sens" if path.is_file() else len(visible(path.glob("*.sens"))) == 1


def read(path: Path, options: ReadOptions) -> Recording:
    file = path if not path.is_dir() else next(iter(visible(path.glob("*.sens"))), None)
    if file is None:
        raise RecordingError(f"{path}: expected a .sens file, there is none")
    if file != path:
        file = inside(path, file.name, str(path))
    try:
        frames = _read_frames(file)
    except (struct.error, OSError) as problem:
        raise RecordingError(f"{file}: is no .sens file, or cut off or damaged: {problem}") from problem
    return recording_of_frames(path, NAME, SENSOR, frames, options)


def _read_frames(path: Path) -> list[ListedFrame]:
    check_input(path, RecordingError)
    size = path.stat().st_size
    with path.open("rb") as file:

        def take(form: str) -> tuple:
            return struct.unpack(f"<{form}", file.read(struct.calcsize(f"<{form}")))

        version, length = take("IQ")
        if version != VERSION or length > MAX_NAME:
            raise RecordingError(f"{path}: expected a .sens file of version {VERSION}, got {version}, or it is damaged")
        file.seek(length, os.SEEK_CUR)
        K_color, T_color, K_depth, T_depth = (np.reshape(take("16f"), (4, 4)).astype(np.float64) for _ in range(4))
        color_kind, depth_kind, *sizes = take("2i4I")
        depth_scale, count = take("fQ")
        if color_kind not in COLOR_KINDS or depth_kind not in (DEPTH_STORED, DEPTH_ZLIB):
            raise RecordingError(
                f"{path}: expected colour as PNG or JPEG and depth as zlib, got {color_kind}, {depth_kind}"
            )
        if not 0 < sizes[2] * sizes[3] <= MAX_PIXELS or count > size // FRAME_HEADER.size:
            raise RecordingError(f"{path}: is damaged: {count} frames of {sizes[2]}x{sizes[3]} pixels")
        if not (np.isfinite(depth_scale) and depth_scale > 0):
            raise RecordingError(f"{path}: expected positive depth units per metre, got {depth_scale}")
        if not (np.isfinite(K_color).all() and np.isfinite(K_depth).all()):
            raise RecordingError(f"{path}: expected camera matrices of finite numbers")
        color, depth = (
            intrinsics_from_matrix(K[:3, :3], (width, height), path)
            for K, width, height in ((K_color, *sizes[:2]), (K_depth, *sizes[2:]))
        )
        T_color_depth = se_inverse(_extrinsics(T_color, path)) @ _extrinsics(T_depth, path)
        frames = []
        for i in range(count):
            header = FRAME_HEADER.unpack(file.read(FRAME_HEADER.size))
            depth_time, color_size, depth_size = header[17:]
            start = file.tell()
            if start + color_size + depth_size > size:
                raise RecordingError(f"{path}: is cut off in frame {i} of {count}")
            file.seek(color_size + depth_size, os.SEEK_CUR)
            pose = np.reshape(header[:16], (4, 4))
            frames.append(
                ListedFrame(
                    f"{i:06d}",
                    partial(_color, path, start, color_size, i),
                    partial(_depth, path, start + color_size, depth_size, depth_kind, (sizes[3], sizes[2]), i),
                    color,
                    float(depth_scale),
                    parse_pose(pose, f"{path}: frame {i}") if np.isfinite(pose).all() else None,
                    depth_time / 1e6,
                    depth,
                    T_color_depth,
                    path,
                )
            )
    return frames


def _extrinsics(T: np.ndarray, path: Path) -> np.ndarray:
    return parse_pose(T, str(path)) if T.any() else np.eye(4)


def _part(path: Path, start: int, size: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(size)


def _color(path: Path, start: int, size: int, i: int) -> np.ndarray:
    return decoded_color(_part(path, start, size), Path(f"{path}: frame {i}"))


def _depth(path: Path, start: int, size: int, kind: int, shape: tuple[int, int], i: int) -> np.ndarray:
    data = _part(path, start, size)
    expected = 2 * shape[0] * shape[1]
    try:
        if kind == DEPTH_ZLIB:
            data = zlib.decompressobj().decompress(data, expected)
    except zlib.error as problem:
        raise RecordingError(f"{path}: frame {i}: the depth is damaged: {problem}") from problem
    if len(data) != expected:
        raise RecordingError(f"{path}: frame {i}: expected {expected} bytes of depth, got {len(data)}")
    return np.frombuffer(data, "<u2").reshape(shape).astype(np.uint16)
