"""One ROS bag as its RGB-D cameras: their times, calibrations, transforms and messages."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from adagmm_fusion.errors import RecordingError, one_line
from adagmm_fusion.files.input_file import check_input
from adagmm_fusion.formats.ros_topics import CameraTopics, find_cameras
from adagmm_fusion.formats.ros_transforms import StaticTransforms
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.rigs.rig import SENSOR_NAME
from adagmm_o3d.errors import InputError

TF, TF_STATIC = "/tf", "/tf_static"
# Messages of transforms that rosbags does not know of ROS 1: tf2's, and those of tf before it.
ROS1_TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
OPENCV_MODELS = ("plumb_bob", "rational_polynomial", "")


class RosBag:
    """The cameras of a bag, their times, calibrations and messages.

    Raises
    ------
    RecordingError  if it is no bag, or damaged, or has no camera with colour and depth.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not path.is_dir():
            check_input(path, RecordingError)
        ros1 = path.suffix.lower() == ".bag"
        self._types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        for name in ROS1_TRANSFORMS if ros1 else ():
            self._types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
        self._deserialize = self._types.deserialize_ros1 if ros1 else self._types.deserialize_cdr
        with self._guarded("is no ROS bag, or cut off or damaged"):
            self._reader: Any = Reader1(path) if ros1 else Reader2(path)
            self._reader.open()
            self._connections: dict[str, list[Any]] = {}
            for connection in self._reader.connections:
                self._connections.setdefault(connection.topic, []).append(connection)
        topics = [(topic, found[0].msgtype) for topic, found in self._connections.items()]
        self.cameras = find_cameras(topics)
        if not self.cameras:
            listed = ", ".join(topic for topic, kind in topics if kind.endswith("Image")) or "no images at all"
            raise RecordingError(f"{path}: expected topics of a camera's colour and depth images, got {listed[:300]}")
        for camera in self.cameras:
            if not SENSOR_NAME.fullmatch(camera.name):
                raise RecordingError(f"{path}: the camera's name {camera.name!a} cannot be a sensor's")
        self._times = {
            topic: self._times_of(topic) for camera in self.cameras for topic in (camera.color, camera.depth)
        }
        self._infos: dict[str, Any] = {}
        self._transforms: StaticTransforms | None = None

    def moments(self, camera: CameraTopics) -> list[tuple[int, int]]:
        """(time of the depth image, of the colour image next to it) [ns], of those that have one within a frame."""
        colors, depths = self._times[camera.color], self._times[camera.depth]
        at = np.clip(np.searchsorted(colors, depths), 1, max(len(colors) - 1, 1))
        before, after = colors[at - 1], colors[np.minimum(at, len(colors) - 1)]
        nearest = np.where(np.abs(before - depths) <= np.abs(after - depths), before, after)
        near = np.abs(nearest - depths) <= self.interval(camera)
        moments = [(int(d), int(c)) for d, c in zip(depths[near], nearest[near], strict=True)]
        if not moments:
            raise RecordingError(f"{self.path}: {camera.name}: no colour image is next to a depth image in time")
        return moments

    def interval(self, camera: CameraTopics) -> float:
        """The median time between two depth images [ns]."""
        times = self._times[camera.depth]
        return float(np.median(np.diff(times))) if len(times) > 1 else 1e9

    def intrinsics(self, camera: CameraTopics) -> PinholeIntrinsics | None:
        """Of the colour image; None without camera_info."""
        return self._intrinsics(camera.color, camera.color_info)

    def depth_intrinsics(self, camera: CameraTopics) -> PinholeIntrinsics | None:
        """Of the depth image; None where it has no camera_info, and is taken for registered."""
        return self._intrinsics(camera.depth, camera.depth_info)

    def T_color_depth(self, camera: CameraTopics) -> np.ndarray:
        """(4, 4) [m]. Raises RecordingError if the bag does not say it."""
        frames = [self._info(info).header.frame_id for info in (camera.color_info, camera.depth_info)]
        T = self._tf().between(*frames)
        if T is None:
            raise RecordingError(
                f"{self.path}: {camera.name}: the depth is not registered to the colour, and no tf_static says where "
                f"{frames[1][:60]} is in {frames[0][:60]}, nor does what stands still in /tf; record /tf_static or the "
                "registered depth topic"
            )
        return T

    def T_color(self, target: CameraTopics, source: CameraTopics) -> np.ndarray | None:
        """T_target_source (4, 4) between the colour images of two cameras, or None where the bag does not say it."""
        infos = [self._info(camera.color_info) for camera in (target, source)]
        return None if None in infos else self._tf().between(*(info.header.frame_id for info in infos))

    def message(self, topic: str, time: int) -> Any:
        """The message of a topic at a time [ns] that it has."""
        return next(self._messages(topic, time))

    def _messages(self, topic: str, time: int | None = None) -> Iterator[Any]:
        if topic not in self._connections:
            return
        with self._guarded(f"{topic}: is damaged"):
            stop = None if time is None else time + 1
            for connection, _, data in self._reader.messages(self._connections[topic], time, stop):
                yield self._deserialize(data, connection.msgtype)
        if time is not None:
            raise RecordingError(f"{self.path}: {topic}: the message at {time} ns is gone")

    def _times_of(self, topic: str) -> np.ndarray:
        with self._guarded(f"{topic}: is damaged"):
            if isinstance(self._reader, Reader1):
                times = [entry.time for c in self._connections[topic] for entry in self._reader.indexes[c.id]]
            else:
                times = [time for _, time, _ in self._reader.messages(self._connections[topic])]
        if not times:
            raise RecordingError(f"{self.path}: there is no image in {topic}")
        return np.unique(np.array(times, dtype=np.int64))

    def _info(self, topic: str) -> Any:
        if topic not in self._infos:
            self._infos[topic] = next(self._messages(topic), None)
        return self._infos[topic]

    def _intrinsics(self, topic: str, info_topic: str) -> PinholeIntrinsics | None:
        info = self._info(info_topic)
        if info is None:
            return None
        K, D, P = (np.asarray(getattr(info, name, getattr(info, name.lower(), ()))) for name in "KDP")
        distortion = tuple(float(x) for x in D) if np.any(D) else ()
        if "rect" in topic and P.size == 12 and P[0] > 0:
            K, distortion = P.reshape(3, 4)[:, :3].ravel(), ()
        if distortion and info.distortion_model not in OPENCV_MODELS:
            raise RecordingError(
                f"{self.path}: {info_topic}: expected the distortion model plumb_bob or rational_polynomial, got "
                f"{info.distortion_model[:40]!r}; record the rectified images"
            )
        try:
            return PinholeIntrinsics(info.width, info.height, K[0], K[4], K[2], K[5], distortion)
        except (InputError, IndexError) as problem:
            raise RecordingError(f"{self.path}: {info_topic}: {problem}") from problem

    def _tf(self) -> StaticTransforms:
        if self._transforms is None:
            transforms = StaticTransforms()
            for topic, add in ((TF_STATIC, transforms.add), (TF, transforms.add_repeated)):
                for message in self._messages(topic):
                    try:
                        add(message)
                    except InputError as problem:
                        raise RecordingError(f"{self.path}: {topic}: {problem}") from problem
            transforms.settle()
            self._transforms = transforms
        return self._transforms

    def _guarded(self, what: str) -> "_Guard":
        return _Guard(f"{self.path}: {what}")


class _Guard:
    """rosbags raises whatever the damage leads to; here that becomes a RecordingError."""

    def __init__(self, start: str) -> None:
        self.start = start

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: Any, problem: BaseException | None, trace: Any) -> None:
        if isinstance(problem, Exception) and not isinstance(problem, RecordingError):
            reason = one_line(problem) or type(problem).__name__
            raise RecordingError(f"{self.start}: {reason[:200]}") from problem
