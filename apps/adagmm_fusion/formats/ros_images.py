"""ROS image messages as arrays.

sensor_msgs/Image             colour rgb8, bgr8, rgba8, bgra8, mono8, yuv422 (UYVY), yuv422_yuy2; depth 16UC1 and mono16
                              in millimetres, 32FC1 in metres
sensor_msgs/CompressedImage   colour as JPEG or PNG; depth as compressed_depth_image_transport writes it: 12 bytes
                              (int32, two float32 a, b), then a PNG, for 16UC1 of millimetres, for 32FC1 of x, where
                              z = a / (x - b)
"""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import PNG_SIGNATURE, decoded_color, decoded_depth

MILLIMETRES_PER_METRE = 1000.0
CHANNELS = {"rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1, "8uc1": 1, "8uc3": 3}
YUV = {"yuv422": cv2.COLOR_YUV2RGB_UYVY, "uyvy": cv2.COLOR_YUV2RGB_UYVY, "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2}
DEPTHS = {"16uc1": "u2", "mono16": "u2", "32fc1": "f4"}
DEPTH_HEADER = np.dtype([("format", "<i4"), ("a", "<f4"), ("b", "<f4")])


def color_image(message: Any, where: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB. Raises RecordingError, starting with `where`, for what is no such image."""
    if hasattr(message, "format"):
        return decoded_color(bytes(message.data), where)
    encoding = message.encoding.lower()
    if encoding in YUV:
        return cv2.cvtColor(_rows(message, "u1", 2, where), YUV[encoding])
    if encoding not in CHANNELS:
        known = ", ".join((*CHANNELS, *YUV))
        raise RecordingError(f"{where}: expected colour as one of {known}, got {message.encoding[:40]!r}")
    image = _rows(message, "u1", CHANNELS[encoding], where)
    if image.shape[2] == 1:
        return np.repeat(image, 3, axis=2)
    order = [2, 1, 0] if encoding.startswith("bgr") or encoding == "8uc3" else [0, 1, 2]
    return np.ascontiguousarray(image[:, :, order])


def depth_image(message: Any, where: Path) -> np.ndarray:
    """(H, W), uint16 millimetres or float32 metres; 0 or NaN where there is none. Raises RecordingError as above."""
    if hasattr(message, "format"):
        return _compressed_depth(message, where)
    encoding = message.encoding.lower()
    if encoding not in DEPTHS:
        raise RecordingError(
            f"{where}: expected depth as 16UC1, mono16 or 32FC1, got {message.encoding[:40]!r}; is it a preview?"
        )
    order = ">" if message.is_bigendian else "<"
    image = _rows(message, order + DEPTHS[encoding], 1, where)[:, :, 0]
    return image.astype(image.dtype.newbyteorder("="))


def depth_units(depth: np.ndarray) -> float:
    """Units per metre of such a depth image."""
    return MILLIMETRES_PER_METRE if depth.dtype == np.uint16 else 1.0


def _compressed_depth(message: Any, where: Path) -> np.ndarray:
    data = bytes(message.data)
    start = data[: DEPTH_HEADER.itemsize + len(PNG_SIGNATURE)].find(PNG_SIGNATURE)
    if start not in (0, DEPTH_HEADER.itemsize):
        raise RecordingError(f"{where}: expected depth as PNG, got {message.format[:60]!r}; record the raw topic")
    stored = decoded_depth(data[start:], where)
    if "32FC1" not in message.format.split(";")[0]:
        return stored
    if start == 0:
        raise RecordingError(f"{where}: the scale of {message.format[:60]!r} is missing")
    header = np.frombuffer(data, DEPTH_HEADER, 1)[0]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = header["a"] / (stored.astype(np.float32) - header["b"])
    return np.where(stored > 0, depth, np.float32(0.0)).astype(np.float32)


def _rows(message: Any, kind: str, channels: int, where: Path) -> np.ndarray:
    """(H, W, channels) of a message whose rows may be padded."""
    try:
        rows = np.asarray(message.data, dtype=np.uint8).reshape(message.height, message.step)
        width = message.width * channels * np.dtype(kind).itemsize
        if not rows.size or width > message.step:
            raise ValueError("it has no pixels" if not rows.size else "its rows are too short")
        return np.ascontiguousarray(rows[:, :width]).view(kind).reshape(message.height, message.width, channels)
    except ValueError as problem:
        raise RecordingError(f"{where}: an image is not whole: {problem}") from problem
