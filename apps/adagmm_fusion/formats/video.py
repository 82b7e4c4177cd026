"""Azure Kinect .mkv and RealSense .bag files.

The recording is one file (one moving sensor, no ground truth) or a folder with one file for each of several
synchronised sensors, whose names are the files' names, the first one by name being the target. Times count from each
file's first depth image, which synchronised recordings share. A rig with these sensors gives their poses, and replaces
the intrinsics. There is a frame for each depth image, whatever the clock says between them; frames of several sensors
belong together where their times differ by less than half a frame. What is in the files: bag_stream.py,
azure_kinect.py.
"""

from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import checked_frame, inside
from adagmm_fusion.files.input_file import visible
from adagmm_fusion.formats import ros_bag
from adagmm_fusion.formats.azure_kinect import AzureKinectStream
from adagmm_fusion.formats.bag_stream import BagStream, is_realsense
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
    calibrations = [
        options.calibration(file.stem, stream.intrinsics, stream.depth_scale, file)
        for file, stream in zip(files, streams, strict=True)
    ]
    entries: list[FrameEntry] = []
    pairs: list[PairEntry] = []
    names = _names(streams[0].times)
    for number, moment in enumerate(_moments([stream.times for stream in streams], fps)):
        first = len(entries)
        for file, stream, calibration, index in zip(files, streams, calibrations, moment, strict=True):
            if index is None:
                continue
            pose = options.sensor_pose(file.stem) if len(files) > 1 else None
            load = partial(_load, file, names[number], index, *calibration)
            entries.append(FrameEntry(names[number], file.stem, load, pose, float(stream.times[index])))
        if number % options.step == 0:
            pairs += [PairEntry(other, first) for other in range(first + 1, len(entries))]
    if len(files) == 1:
        pairs = list(sequential_pairs(len(entries), options.step))
    notes = tuple(f"{file.name}: {note}" for file, s in zip(files, streams, strict=True) for note in s.notes)
    return Recording(path.stem, path, NAME, tuple(entries), tuple(pairs), notes=notes)


def _moments(times: list[np.ndarray], fps: float) -> Iterator[list[int | None]]:
    """For each frame of the first sensor its index, and of the others that of the frame within half a frame of it, each
    frame once, or None."""
    first, *others = times
    orders = [np.argsort(other, kind="stable") for other in others]
    used: list[set[int]] = [set() for _ in others]
    for index, time in enumerate(first):
        moment: list[int | None] = [index]
        for other, order, taken in zip(others, orders, used, strict=True):
            low, high = np.searchsorted(other[order], (time - 0.5 / fps, time + 0.5 / fps))
            near = [int(i) for i in order[low:high] if int(i) not in taken]
            found = min(near, key=lambda i: abs(other[i] - time), default=None)
            taken |= set() if found is None else {found}
            moment.append(found)
        yield moment


def _names(times: np.ndarray) -> list[str]:
    """Frames are called by their time; by their number where times repeat or run before the first."""
    names = [f"{round(1000 * time):08d}ms" for time in times]
    if times.min() < 0 or len(set(names)) < len(names):
        return [f"{number:06d}" for number in range(len(names))]
    return names


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path] if path.suffix.lower() in SUFFIXES else []
    files = [file for file in visible(path.iterdir()) if file.suffix.lower() in SUFFIXES]
    return [inside(path, file.name, str(path)) for file in files]


def _load(file: Path, name: str, index: int, intrinsics: PinholeIntrinsics, depth_scale: float) -> RGBDFrame:
    color, depth, timestamp = _open(str(file)).at(index)
    return checked_frame(file, name, color, depth, intrinsics, depth_scale, file.stem, timestamp)


@lru_cache(maxsize=4)
def _open(path: str) -> BagStream | AzureKinectStream:
    """An open file. It cannot go to another process, so each process opens its own."""
    return AzureKinectStream(path) if path.lower().endswith(".mkv") else BagStream(path)
