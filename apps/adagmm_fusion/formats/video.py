"""Azure Kinect .mkv and RealSense .bag files.

The recording is one file (one moving sensor, no ground truth) or a folder with one file for each of several
synchronised sensors, whose names are the files' names, the first one by name being the target. Times count from each
file's first depth image, which synchronised recordings share. A rig with these sensors gives their poses, and replaces
the intrinsics. What is in the files, and how frames are found by time: bag_stream.py and mkv_stream.py.
"""

import math
from functools import lru_cache, partial
from pathlib import Path

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import checked_frame, inside
from adagmm_fusion.files.matroska_file import is_matroska
from adagmm_fusion.formats import ros_bag
from adagmm_fusion.formats.azure_kinect import AzureKinectStream
from adagmm_fusion.formats.bag_stream import BagStream, is_realsense
from adagmm_fusion.formats.mkv_stream import MKVStream
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording, sequential_pairs

NAME = "video"
SUMMARY = "Azure Kinect .mkv or RealSense .bag, one file or a folder of synchronised ones"
SUFFIXES = (".mkv", ".bag")


def matches(path: Path) -> bool:
    return bool(_files(path))


def read(path: Path, options: ReadOptions) -> Recording:
    files = _files(path)
    if not files:
        raise RecordingError(f"{path}: expected an .mkv or .bag file, or a folder with some")
    if len(files) == 1 and files[0].suffix.lower() == ".bag" and not is_realsense(files[0]):
        return ros_bag.read(files[0], options)
    streams = [_open(str(file)) for file in files]
    fps = streams[0].fps
    for file, stream in zip(files, streams, strict=True):
        if stream.fps != fps:
            raise RecordingError(f"{file}: {stream.fps:g} frames a second, but {files[0].name} has {fps:g}")
    count = max(1, math.floor(min(stream.seconds for stream in streams) * fps + 1e-6))
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
    notes = tuple(f"{file.name}: {note}" for file, s in zip(files, streams, strict=True) for note in s.notes)
    return Recording(path.stem, path, NAME, tuple(entries), pairs, notes=notes)


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if path.suffix.lower() in SUFFIXES else []
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES)
    return [inside(path, file.name, str(path)) for file in files]


def _load(file: Path, name: str, seconds: float, intrinsics: PinholeIntrinsics, depth_scale: float) -> RGBDFrame:
    color, depth, timestamp = _open(str(file)).at(seconds)
    return checked_frame(file, name, color, depth, intrinsics, depth_scale, file.stem, timestamp)


@lru_cache(maxsize=4)
def _open(path: str) -> BagStream | AzureKinectStream | MKVStream:
    """An open file. It cannot go to another process, so each process opens its own."""
    if not path.lower().endswith(".mkv"):
        return BagStream(path)
    # What is no Matroska file is left to Open3D, which says so.
    return AzureKinectStream(path) if is_matroska(Path(path)) else MKVStream(path)
