"""One RealSense .bag file: a ROS 1 bag as librealsense records it.

/device_0/sensor_<n>/Depth_0/image/data, .../Color_0/image/data     sensor_msgs/Image: mono16; rgb8, bgr8, rgba8, bgra8
.../Depth_0/info, .../Color_0/info                                  realsense_msgs/StreamInfo: frames a second
.../info/camera_info                                                sensor_msgs/CameraInfo: intrinsics
.../tf/0                                                            geometry_msgs/Transform: common frame to stream
/device_0/sensor_<n>/option/Depth Units/value                       std_msgs/Float32: metres

Open3D's RSBagReader reads ahead in another thread: after seeking, its frames have another frame's colour, depth or
time, and which ones changes from run to run. So the messages are read one by one here, by their times.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import check_input
from adagmm_fusion.frames.depth_registration import register_depth
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

STREAM_INFO = "uint32 fps\nstring encoding\nbool is_recommended\n"
DEPTH_ENCODINGS = ("mono16", "16UC1")
# Where the colour channels are in each encoding.
COLOR_CHANNELS = {"rgb8": [0, 1, 2], "bgr8": [2, 1, 0], "rgba8": [0, 1, 2], "bgra8": [2, 1, 0]}
# The one distortion model whose coefficients are OpenCV's; other models' coefficients are not used.
OPENCV_MODEL = "brown conrady"


def is_realsense(path: Path) -> bool:
    """Whether a .bag has RealSense's own topics; true also of what is no bag, which BagStream then says."""
    check_input(path, RecordingError)
    try:
        with Reader(path) as reader:
            return any(connection.topic.startswith("/device_0/") for connection in reader.connections)
    except Exception:  # rosbags raises whatever the damage leads to
        return True


@dataclass(frozen=True, eq=False)
class _Shots:
    """The images of a topic in the order of their recording.    times : (n,) int64 [ns].    places : (n,) in it.

    entries : (n,) of the bag's index.
    """

    times: np.ndarray
    places: np.ndarray
    entries: list[Any]


class BagStream:
    """Colour and depth of one camera, a frame for each depth image in the order of their recording; depth is registered
    to the colour image where it is not yet.

    intrinsics : of the colour image.    depth_scale : units per metre.    fps : of the depth.
    times : (n,) of the depth images [s], from the first one; where the clock was set, they leap or run backwards.
    notes : what of its calibration is not used.

    Raises
    ------
    RecordingError  if the file is no such bag, or damaged.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self.notes: list[str] = []
        self._types = get_typestore(Stores.ROS1_NOETIC)
        self._types.register(get_types_from_msg(STREAM_INFO, "realsense_msgs/msg/StreamInfo"))
        check_input(Path(path), RecordingError)
        self._reader = Reader(Path(path))
        try:
            self._reader.open()
        except Exception as problem:  # rosbags raises whatever the damage leads to
            raise RecordingError(f"{path}: is no ROS bag, or cut off or damaged: {_one_line(problem)}") from problem
        self._topics = {connection.topic: connection for connection in self._reader.connections}
        depth, color = self._stream("Depth"), self._stream("Color")
        self._images = {"Depth": f"{depth}/image/data", "Color": f"{color}/image/data"}
        self._shots = {name: self._shots_of(topic) for name, topic in self._images.items()}
        self.fps = float(self._first(f"{depth}/info").fps)
        self.depth_scale = self._depth_scale(depth)
        self._depth_intrinsics, self.intrinsics = self._intrinsics(depth), self._intrinsics(color)
        self._T_color_depth = self._T_stream_common(color) @ se_inverse(self._T_stream_common(depth))
        if self.fps <= 0:
            raise RecordingError(f"{path}: expected a positive frame rate, got {self.fps:g}")
        depth_shots, color_shots = self._shots["Depth"], self._shots["Color"]
        self.times = (depth_shots.times - depth_shots.times[0]) / 1e9
        # Where the clock was set back, a colour image of the other stretch may have the time of a depth image.
        starts = depth_shots.places[np.flatnonzero(np.diff(self.times) < -0.5 / self.fps) + 1]
        self._stretches = {
            name: np.searchsorted(starts, shots.places, side="right")
            for name, shots in (("Depth", depth_shots), ("Color", color_shots))
        }

    def at(self, index: int) -> tuple[np.ndarray, np.ndarray, float]:
        """RGB (H, W, 3), depth (H, W) and time [s] of a depth image, with the colour nearest to it in time.

        Raises
        ------
        RecordingError  if there is no colour within a frame of it, or an image is not as expected.
        """
        time = int(self._shots["Depth"].times[index])
        apart = np.abs(self._shots["Color"].times - time)
        apart[self._stretches["Color"] != self._stretches["Depth"][index]] = np.iinfo(np.int64).max
        nearest = int(np.argmin(apart))
        if apart[nearest] > 1e9 / self.fps:
            far = f"{apart[nearest] / 1e6:.0f} ms away" if apart[nearest] < np.iinfo(np.int64).max else "not there"
            raise RecordingError(f"{self.path}: the colour nearest to {self.times[index]:.3f} s is {far}")
        depth = self._image("Depth", index)
        color = self._image("Color", nearest)
        if not (self._depth_intrinsics == self.intrinsics and np.allclose(self._T_color_depth, np.eye(4), atol=1e-6)):
            registered = register_depth(
                depth, self._depth_intrinsics, _ideal(self.intrinsics), self._T_color_depth, self.depth_scale
            )
            depth = np.floor(registered + 0.5).astype(np.uint16)
        return color, depth, float(self.times[index])

    def _stream(self, name: str) -> str:
        found = [t for t in self._topics if re.fullmatch(rf"/device_0/sensor_\d+/{name}_0/image/data", t)]
        if not found:
            raise RecordingError(f"{self.path}: expected a RealSense recording with {name}_0 images, there are none")
        return found[0].removesuffix("/image/data")

    def _shots_of(self, topic: str) -> _Shots:
        entries = self._entries(topic)
        if not entries:
            raise RecordingError(f"{self.path}: there is no image in {topic}")
        chunks = {place: number for number, place in enumerate(sorted(self._reader.chunks))}
        places = np.array([(chunks[entry.chunk_pos] << 32) + entry.offset for entry in entries], dtype=np.int64)
        order = np.argsort(places, kind="stable")
        ordered = [entries[i] for i in order]
        return _Shots(np.array([entry.time for entry in ordered], dtype=np.int64), places[order], ordered)

    def _entries(self, topic: str) -> list[Any]:
        return list(self._reader.indexes[self._topics[topic].id]) if topic in self._topics else []

    def _first(self, topic: str) -> Any:
        entries = self._entries(topic)
        if not entries:
            raise RecordingError(f"{self.path}: {topic} is missing; record it anew with RealSense's own tools")
        return self._message(topic, entries[0])

    def _message(self, topic: str, entry: Any) -> Any:
        connection = self._topics[topic]
        self._reader.indexes[connection.id] = [entry]  # it would look through all that come before
        try:
            _, _, data = next(self._reader.messages([connection]))
            return self._types.deserialize_ros1(data, connection.msgtype)
        except Exception as problem:  # rosbags raises whatever the damage leads to
            raise RecordingError(f"{self.path}: {topic}: is damaged: {_one_line(problem)}") from problem

    def _depth_scale(self, depth: str) -> float:
        units = float(self._first(f"{depth.rpartition('/')[0]}/option/Depth Units/value").data)
        if not 0 < units < float("inf"):
            raise RecordingError(f"{self.path}: expected positive Depth Units [m], got {units}")
        return float(np.round(1.0 / units, 3))  # stored as float32

    def _intrinsics(self, stream: str) -> PinholeIntrinsics:
        info = self._first(f"{stream}/info/camera_info")
        opencvs = info.distortion_model.lower().replace("_", " ") == OPENCV_MODEL
        distortion = tuple(map(float, info.D)) if opencvs and np.any(info.D) else ()
        if np.any(info.D) and not opencvs:
            self.notes.append(f"{stream}: the lens distortion of the model {info.distortion_model[:40]} is not used")
        try:
            return PinholeIntrinsics(info.width, info.height, info.K[0], info.K[4], info.K[2], info.K[5], distortion)
        except InputError as problem:
            raise RecordingError(f"{self.path}: {stream}/info/camera_info: {problem}") from problem

    def _T_stream_common(self, stream: str) -> np.ndarray:
        tf = self._first(f"{stream}/tf/0")
        T = np.eye(4)
        quaternion = tf.rotation.x, tf.rotation.y, tf.rotation.z, tf.rotation.w
        try:
            T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
        except ValueError as problem:
            raise RecordingError(f"{self.path}: {stream}/tf/0: expected a rotation, got {quaternion}") from problem
        T[:3, 3] = tf.translation.x, tf.translation.y, tf.translation.z
        try:
            return checked_rigid_transformation(T, "pose")
        except InputError as problem:
            raise RecordingError(f"{self.path}: {stream}/tf/0: {problem}") from problem

    def _image(self, name: str, index: int) -> np.ndarray:
        """(H, W) uint16 depth, or (H, W, 3) uint8 RGB."""
        shots = self._shots[name]
        time = int(shots.times[index])
        message = self._message(self._images[name], shots.entries[index])
        known = DEPTH_ENCODINGS if name == "Depth" else tuple(COLOR_CHANNELS)
        if message.encoding not in known:
            raise RecordingError(f"{self.path}: expected {name} as {', '.join(known)}, got {message.encoding!r}")
        order = ">" if message.is_bigendian else "<"
        kind, channels = (f"{order}u2", 1) if name == "Depth" else ("u1", len(message.encoding.removesuffix("8")))
        try:
            rows = np.asarray(message.data).reshape(message.height, message.step)
            pixels = np.ascontiguousarray(rows[:, : message.width * channels * np.dtype(kind).itemsize]).view(kind)
            image = pixels.reshape(message.height, message.width, channels)
        except ValueError as problem:
            raise RecordingError(f"{self.path}: {name} at {time} ns is not whole: {problem}") from problem
        if name == "Depth":
            return image[:, :, 0].astype(np.uint16)
        return np.ascontiguousarray(image[:, :, COLOR_CHANNELS[message.encoding]])


def _ideal(k: PinholeIntrinsics) -> PinholeIntrinsics:
    return PinholeIntrinsics(k.width, k.height, k.fx, k.fy, k.cx, k.cy)


def _one_line(problem: Exception) -> str:
    return " ".join(str(problem).split()) or type(problem).__name__
