"""Azure Kinect .mkv and RealSense .bag files, through Open3D's readers, which register the depth to the colour image.

The recording is one file (one moving sensor, no ground truth) or a folder with one file for each of several
synchronised sensors, whose names are the files' names, the first one by name being the target. Times count from each
file's start, which synchronised recordings share. A rig with these sensors gives their poses, and replaces the
intrinsics:

    .bag    intrinsics (Open3D leaves out the distortion), depth scale and frame rate are the file's own. Frames are
            sought by time, and say what time they really have
    .mkv    Open3D's Python interface tells neither intrinsics nor frame rate, so a rig is needed, and 30 frames a
            second are taken. Depth in millimetres. Open3D needs libk4a and libk4arecord, which it does not bring along
"""

import math
import re
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.frame_sequence import FrameEntry, PairEntry, Recording, sequential_pairs
from adagmm_fusion.frames import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.image_files import checked_frame, inside

NAME = "video"
SUMMARY = "Azure Kinect .mkv or RealSense .bag, one file or a folder of synchronised ones"
SUFFIXES = (".mkv", ".bag")
MKV_FPS, MKV_DEPTH_SCALE = 30.0, 1000.0
# Where the colour channels are in each of Open3D's pixel formats.
COLOR_CHANNELS = {"RGB8": [0, 1, 2], "BGR8": [2, 1, 0], "RGBA8": [0, 1, 2], "BGRA8": [2, 1, 0]}


def matches(path: Path) -> bool:
    return bool(_files(path))


def read(path: Path, options: ReadOptions) -> Recording:
    files = _files(path)
    if not files:
        raise RecordingError(f"{path}: expected an .mkv or .bag file, or a folder with some")
    streams = [_open(str(file)) for file in files]
    fps = streams[0].fps
    for file, stream in zip(files, streams, strict=True):
        if stream.fps != fps:
            raise RecordingError(f"{file}: {stream.fps:g} frames a second, but {files[0].name} has {fps:g}")
    count = max(1, math.floor(min(stream.seconds for stream in streams) * fps))
    entries = []
    for i in range(count):
        for file, stream in zip(files, streams, strict=True):
            sensor, seconds = file.stem, i / fps
            calibration = options.calibration(sensor, stream.intrinsics, stream.depth_scale, file)
            name = f"{round(1000 * seconds):08d}ms"
            pose = options.sensor_pose(sensor) if len(files) > 1 else None
            entries.append(FrameEntry(name, sensor, partial(_load, file, name, seconds, *calibration), pose, seconds))
    if len(files) == 1:
        pairs = sequential_pairs(count, options.step)
    else:
        first = range(0, len(entries), len(files) * options.step)
        pairs = tuple(PairEntry(i + other, i) for i in first for other in range(1, len(files)))
    return Recording(path.stem, path, NAME, tuple(entries), pairs)


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if path.suffix.lower() in SUFFIXES else []
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    return [inside(path, file.name, str(path)) for file in files]


def _load(file: Path, name: str, seconds: float, intrinsics: PinholeIntrinsics, depth_scale: float) -> RGBDFrame:
    color, depth, timestamp = _open(str(file)).at(seconds)
    return checked_frame(file, name, color, depth, intrinsics, depth_scale, file.stem, timestamp)


@dataclass(eq=False)
class _Stream:
    """One open file. Readers cannot go to another process, so each process opens its own (see _open)."""

    path: str
    reader: Any  # AzureKinectMKVReader or RSBagReader
    seconds: float
    fps: float
    intrinsics: PinholeIntrinsics | None
    depth_scale: float
    channels: list[int]

    def at(self, seconds: float) -> tuple[np.ndarray, np.ndarray, float]:
        """RGB (H, W, 3), depth (H, W) and time of the first whole frame from a time on."""
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            sought = self.reader.seek_timestamp(round(1e6 * seconds))
            while sought and not self.reader.is_eof():
                frame = self.reader.next_frame()
                if frame is None:  # an .mkv may hold captures without colour or without depth
                    continue
                color, depth = _array(frame.color), _array(frame.depth)
                if color.size and depth.size:
                    own_time = getattr(self.reader, "get_timestamp", None)  # .mkv readers do not tell
                    timestamp = own_time() / 1e6 if own_time else seconds
                    return np.ascontiguousarray(color[..., self.channels]), depth.reshape(depth.shape[:2]), timestamp
        raise RecordingError(f"{self.path}: no frame with colour and depth at {seconds:.3f} s or later")


@lru_cache(maxsize=4)
def _open(path: str) -> _Stream:
    mkv = path.lower().endswith(".mkv")
    try:
        reader: Any = o3d.io.AzureKinectMKVReader() if mkv else o3d.t.io.RSBagReader()
    except AttributeError as problem:
        raise RecordingError(f"{path}: this build of Open3D has no reader for it; use another build") from problem
    try:
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            opened = reader.open(path)
    except RuntimeError as problem:
        reason = re.search(r":\d+: ([^\n]*)", str(problem))  # behind the place in Open3D's source
        raise RecordingError(
            f"{path}: Open3D cannot read such files here: {reason[1] if reason else problem}; "
            "install what is missing (.mkv: libk4a and libk4arecord 1.4)"
        ) from problem
    if not opened:
        raise RecordingError(f"{path}: Open3D cannot open it; it is missing, cut off or not a camera's recording")
    if mkv:
        length = reader.get_metadata().stream_length_usec
        return _Stream(path, reader, length / 1e6, MKV_FPS, None, MKV_DEPTH_SCALE, COLOR_CHANNELS["RGB8"])
    metadata = reader.metadata
    if metadata.color_format not in COLOR_CHANNELS:
        known = ", ".join(COLOR_CHANNELS)
        raise RecordingError(f"{path}: expected colour as {known}, got {metadata.color_format}; record it as RGB8")
    K = metadata.intrinsics.intrinsic_matrix
    intrinsics = PinholeIntrinsics(metadata.width, metadata.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    channels = COLOR_CHANNELS[metadata.color_format]
    return _Stream(
        path, reader, metadata.stream_length_usec / 1e6, metadata.fps, intrinsics, metadata.depth_scale, channels
    )


def _array(image) -> np.ndarray:
    """A copy of an Open3D image, legacy or tensor; the reader uses its own memory again."""
    tensor = getattr(image, "as_tensor", None)
    return np.array(tensor().cpu().numpy() if tensor else image)
