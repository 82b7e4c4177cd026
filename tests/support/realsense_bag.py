"""Writes .bag files as librealsense does: its topics, its message types, a ROS 1 bag by an independent writer."""

from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

STATIC_TIME = 1  # [ns], of what holds for the whole file
FIRST_TIME = 2_000_000
FILE_VERSION = 4


def write_bag(
    path: Path,
    frames,
    depth_intrinsics,
    color_intrinsics,
    *,
    T_color_depth=None,
    fps=30,
    units=0.001,
    color="rgb8",
    times=None,
):
    """frames: (color (H, W, 3) uint8 RGB, depth (h, w) uint16) at `fps`, or at `times` [s]; the depth camera is the
    common frame."""
    types = get_typestore(Stores.ROS1_NOETIC)
    info = "uint32 fps\nstring encoding\nbool is_recommended\n"
    types.register(get_types_from_msg(info, "realsense_msgs/msg/StreamInfo"))
    connections = {}

    def message(kind, *values):
        return types.types[kind](*values)

    with Writer(path) as bag:

        def put(topic, kind, *values, time=STATIC_TIME):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=types)
            bag.write(connections[topic], time, bytes(types.serialize_ros1(message(kind, *values), kind)))

        def header(number, time):
            stamp = message("builtin_interfaces/msg/Time", time // 10**9, time % 10**9)
            return message("std_msgs/msg/Header", number, stamp, "")

        put("/file_version", "std_msgs/msg/UInt32", FILE_VERSION)
        for key, value in (("Name", "Intel RealSense D435"), ("Serial Number", "0"), ("Product Line", "D400")):
            put("/device_0/info", "diagnostic_msgs/msg/KeyValue", key, value)
        poses = (np.eye(4), np.eye(4) if T_color_depth is None else T_color_depth)
        streams = (("Stereo Module", "Depth_0", "mono16"), ("RGB Camera", "Color_0", color))
        for n, ((name, stream, encoding), T) in enumerate(zip(streams, poses, strict=True)):
            sensor, k = f"/device_0/sensor_{n}", (depth_intrinsics, color_intrinsics)[n]
            put(f"{sensor}/info", "diagnostic_msgs/msg/KeyValue", "Name", name)
            if n == 0:
                put(f"{sensor}/option/Depth Units/value", "std_msgs/msg/Float32", units)
                put(f"{sensor}/option/Depth Units/description", "std_msgs/msg/String", "metres")
            put(f"{sensor}/{stream}/info", "realsense_msgs/msg/StreamInfo", fps, encoding, True)
            whole = message("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
            distortion = np.array((*k.distortion, *(0.0,) * (5 - len(k.distortion))))
            camera = (k.height, k.width, "Brown Conrady", distortion, k.matrix().ravel(), np.zeros(9), np.zeros(12))
            put(
                f"{sensor}/{stream}/info/camera_info",
                "sensor_msgs/msg/CameraInfo",
                header(0, 0),
                *camera,
                0,
                0,
                whole,
            )
            turn = message("geometry_msgs/msg/Quaternion", *Rotation.from_matrix(T[:3, :3]).as_quat())
            shift = message("geometry_msgs/msg/Vector3", *map(float, T[:3, 3]))
            put(f"{sensor}/{stream}/tf/0", "geometry_msgs/msg/Transform", shift, turn)
        for number, images in enumerate(frames):
            time = FIRST_TIME + round(number * 1e9 / fps if times is None else times[number] * 1e9)
            color_image = images[0] if color == "rgb8" else images[0][:, :, ::-1]
            for n, image in enumerate((images[1], color_image)):
                if image is None:
                    continue
                sensor, (_, stream, encoding) = f"/device_0/sensor_{n}", streams[n]
                height, width = image.shape[:2]
                data = np.frombuffer(np.ascontiguousarray(image).tobytes(), np.uint8)
                put(
                    f"{sensor}/{stream}/image/data",
                    "sensor_msgs/msg/Image",
                    header(number, time),
                    height,
                    width,
                    encoding,
                    0,
                    len(data) // height,
                    data,
                    time=time,
                )
                for key, value in (("Frame number", str(number)), ("timestamp_domain", "Hardware Clock")):
                    topic = f"{sensor}/{stream}/image/metadata"
                    put(topic, "diagnostic_msgs/msg/KeyValue", key, value, time=time)
