"""Writes ROS bags of RGB-D cameras as `rosbag record` and `ros2 bag record` do, by the rosbags library."""

from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

FIRST_TIME = 10**18
KINDS = ("ros1", "sqlite3", "mcap")


def write_ros_bag(path: Path, kind: str, streams, transforms=(), *, repeated=(), interval_ns: int = 33_000_000) -> Path:
    """Write a bag; returns the path to read: a .bag file, or ROS 2's folder.

    streams : (topic, frame_id, intrinsics or None, encoding, images), the image k at k · interval_ns.
    transforms : (parent, child, T_parent_child) of /tf_static.
    repeated : lists of such transforms, one a message of /tf.
    encoding : ROS's, or "jpeg" and "compressedDepth 16UC1", "compressedDepth 32FC1".
    """
    ros1 = kind == "ros1"
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
            types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr

    def message(name, *values):
        return types.types[name](*values)

    def header(time, frame):
        stamp = message("builtin_interfaces/msg/Time", time // 10**9, time % 10**9)
        return message("std_msgs/msg/Header", *((0,) if ros1 else ()), stamp, frame)

    def image(time, frame, encoding, array):
        if encoding == "jpeg":
            data = np.frombuffer(cv2.imencode(".png", array[:, :, ::-1])[1].tobytes(), np.uint8)
            return message("sensor_msgs/msg/CompressedImage", header(time, frame), "rgb8; png compressed bgr8", data)
        if encoding.startswith("compressedDepth"):
            inner, start = encoding.split()[1], np.zeros(12, np.uint8)
            if inner == "32FC1":
                a, b = 10.0 * 101.0, 1.0  # as the transport chooses them: z = a / (x - b)
                start[4:] = np.frombuffer(np.array([a, b], "<f4").tobytes(), np.uint8)
                with np.errstate(divide="ignore"):
                    array = np.where(array > 0, np.rint(a / array + b), 0).clip(0, 65535).astype(np.uint16)
            png = np.frombuffer(cv2.imencode(".png", array)[1].tobytes(), np.uint8)
            whole = np.concatenate((start, png))
            return message(
                "sensor_msgs/msg/CompressedImage", header(time, frame), f"{inner}; compressedDepth png", whole
            )
        array = np.ascontiguousarray(array[:, :, ::-1] if encoding == "bgr8" else array)
        data = np.frombuffer(array.tobytes(), np.uint8)
        values = (array.shape[0], array.shape[1], encoding, 0, array.strides[0], data)
        return message("sensor_msgs/msg/Image", header(time, frame), *values)

    def info(time, frame, k):
        whole = message("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        D = np.array(k.distortion or (0.0,) * 5)
        P = np.hstack((k.matrix(), np.zeros((3, 1)))).ravel()
        values = (k.height, k.width, "plumb_bob", D, k.matrix().ravel(), np.eye(3).ravel(), P, 0, 0, whole)
        return message("sensor_msgs/msg/CameraInfo", header(time, frame), *values)

    def transform(parent, child, T):
        turn = message("geometry_msgs/msg/Quaternion", *Rotation.from_matrix(T[:3, :3]).as_quat())
        shift = message("geometry_msgs/msg/Vector3", *map(float, T[:3, 3]))
        values = (header(FIRST_TIME, parent), child, message("geometry_msgs/msg/Transform", shift, turn))
        return message("geometry_msgs/msg/TransformStamped", *values)

    file = path.with_suffix(".bag") if ros1 else path
    plugins = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
    with Writer1(file) if ros1 else Writer2(file, version=9, storage_plugin=plugins[kind]) as bag:
        connections = {}

        def put(topic, time, content):
            name = content.__msgtype__
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, name, typestore=types)
            bag.write(connections[topic], time, bytes(serialize(content, name)))

        if transforms:
            put("/tf_static", FIRST_TIME, message("tf2_msgs/msg/TFMessage", [transform(*t) for t in transforms]))
        for number, some in enumerate(repeated):
            name = "tf/msg/tfMessage" if ros1 else "tf2_msgs/msg/TFMessage"  # what publishers of /tf sent in ROS 1
            content = message(name, [transform(*t) for t in some])
            put("/tf", FIRST_TIME + number * interval_ns, content)
        for number in range(max(len(images) for *_, images in streams)):
            for topic, frame, k, encoding, images in streams:
                time = FIRST_TIME + number * interval_ns
                if number < len(images):
                    put(topic, time, image(time, frame, encoding, images[number]))
                    base = topic.removesuffix("/compressed").removesuffix("/compressedDepth").rpartition("/")[0]
                    if k is not None:
                        put(f"{base}/camera_info", time, info(time, frame, k))
    return file
