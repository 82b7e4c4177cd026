"""ROS bags as `rosbag record` and `ros2 bag record` make them: ROS 1 .bag, ROS 2 .db3 and .mcap.

    /<camera>/.../image_raw          sensor_msgs/Image or CompressedImage; see ros_topics.py for which is which, and
                                     ros_images.py for what is in them
    /<camera>/.../camera_info        sensor_msgs/CameraInfo beside each image: its intrinsics, and its frame's name
    /tf_static                       tf2_msgs/TFMessage: where the cameras' frames are

The recording is one file, or ROS 2's folder with a metadata.yaml. Every camera with colour and depth is a sensor; with
several the first by name is the target, and tf_static says where the others are. Depth that is not registered is moved
onto the colour image by tf_static. A frame is a depth image with the colour image recorded next to it in time.
"""

from collections.abc import Iterator
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import checked_frame
from adagmm_fusion.files.input_file import is_given, visible
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.formats.ros_cameras import RosBag
from adagmm_fusion.formats.ros_images import color_image, depth_image, depth_units
from adagmm_fusion.formats.ros_topics import CameraTopics
from adagmm_fusion.frames.one_grid import on_one_grid
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording, sequential_pairs
from adagmm_o3d.errors import InputError

NAME = "rosbag"
SUMMARY = "ROS bag of RGB-D cameras (.bag, .db3, .mcap, or a folder with metadata.yaml)"
SUFFIXES = (".db3", ".mcap")


def matches(path: Path) -> bool:
    """ROS 2's files; a .bag is looked into by `video`, which has RealSense's own."""
    if path.is_file():
        return path.suffix.lower() in SUFFIXES
    return is_given(path / "metadata.yaml") and any(_rosbag_files(path))


def read(path: Path, options: ReadOptions) -> Recording:
    bag = _open(str(path))
    cameras = bag.cameras
    names = [camera.name for camera in cameras]
    first = bag.moments(cameras[0])
    poses = {camera.name: _pose(bag, camera, options, len(cameras)) for camera in cameras}
    entries, moments = [], 0
    for i, (time, _) in enumerate(first):
        found = [(time, first[i][1])] + [_nearest(bag, camera, time) for camera in cameras[1:]]
        if any(moment is None for moment in found):
            continue
        moments += 1
        for camera, moment in zip(cameras, found, strict=True):
            assert moment is not None
            seconds = (moment[0] - first[0][0]) / 1e9
            own = bag.intrinsics(camera)
            load = partial(
                _load, str(path), camera, f"{i:06d}", moment, seconds, _rig_calibration(camera, own, options, path)
            )
            entries.append(FrameEntry(f"{i:06d}", camera.name, load, poses[camera.name], seconds))
    if len(cameras) == 1:
        pairs = sequential_pairs(moments, options.step)
    else:
        starts = range(0, len(entries), len(cameras) * options.step)
        pairs = tuple(PairEntry(start + other, start) for start in starts for other in range(1, len(names)))
    topics = "; ".join(f"{c.name}: colour {c.color}, depth {c.depth}" for c in cameras)
    return Recording(path.stem, path, NAME, tuple(entries), pairs, notes=(topics,))


def _rosbag_files(folder: Path) -> Iterator[Path]:
    return (path for path in visible(folder.iterdir()) if path.suffix.lower() in SUFFIXES)


def _rig_calibration(
    camera: CameraTopics, own: PinholeIntrinsics | None, options: ReadOptions, path: Path
) -> tuple[PinholeIntrinsics, float] | None:
    if options.rig is None and own is not None:
        return None
    return options.calibration(camera.name, own, 1000.0, path)


def _pose(bag: RosBag, camera: CameraTopics, options: ReadOptions, count: int) -> np.ndarray | None:
    if count == 1:
        return None
    if options.rig is not None:
        return options.sensor_pose(camera.name)
    return bag.T_color(bag.cameras[0], camera)


def _nearest(bag: RosBag, camera: CameraTopics, time: int) -> tuple[int, int] | None:
    """The moment of a camera next to a time, at most half a frame away."""
    moments = bag.moments(camera)
    times = np.array([depth for depth, _ in moments])
    nearest = int(np.abs(times - time).argmin())
    return moments[nearest] if abs(moments[nearest][0] - time) <= 0.5 * bag.interval(camera) else None


def _load(
    path: str,
    camera: CameraTopics,
    name: str,
    moment: tuple[int, int],
    seconds: float,
    calibration: tuple[PinholeIntrinsics, float] | None,
) -> RGBDFrame:
    bag = _open(path)
    color = color_image(bag.message(camera.color, moment[1]), Path(path))
    depth = depth_image(bag.message(camera.depth, moment[0]), Path(path))
    depth_scale = depth_units(depth)
    if calibration is None:
        of_depth = bag.depth_intrinsics(camera)
        intrinsics, T_color_depth = bag.intrinsics(camera), None if of_depth is None else bag.T_color_depth(camera)
    else:
        (intrinsics, depth_scale), of_depth, T_color_depth = calibration, None, None
    try:
        grid = on_one_grid(color, depth, intrinsics, depth_scale, of_depth, T_color_depth)
    except InputError as problem:
        raise RecordingError(f"{path}: {camera.name}: {problem}") from problem
    return checked_frame(Path(path), name, *grid, depth_scale, camera.name, seconds)


@lru_cache(maxsize=4)
def _open(path: str) -> RosBag:
    """An open bag. It cannot go to another process, so each process opens its own."""
    return RosBag(Path(path))
