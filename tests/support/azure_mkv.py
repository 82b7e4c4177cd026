"""Writes .mkv files as k4arecorder does: its tracks, tags and attachment, in the elements of RFC 9559."""

import json
import struct
from pathlib import Path

import cv2
import numpy as np

DEPTH_SIZE, COLOR_SIZE = (320, 288), (1280, 720)
# The whole sensor at these modes' resolution, and where the picture begins in it.
DEPTH_SENSOR, DEPTH_CROP = (512, 512), (96, 90)
COLOR_SENSOR, COLOR_CROP = (1280, 960), (0, 120)


def element(kind: int, content: bytes) -> bytes:
    """An element; sizes are written in eight bytes."""
    return kind.to_bytes((kind.bit_length() + 7) // 8, "big") + (1 << 56 | len(content)).to_bytes(8, "big") + content


def number(kind: int, value: int) -> bytes:
    return element(kind, value.to_bytes(8, "big"))


def bitmap_header(size, codec: str) -> bytes:
    return struct.pack("<IiiHH4s", 40, *size, 1, 16, codec.encode()) + bytes(20)


def track(index: int, name: str, size, codec: str) -> bytes:
    video = element(0xE0, number(0xB0, size[0]) + number(0xBA, size[1]))
    values = number(0xD7, index) + element(0x536E, name.encode()) + element(0x86, b"V_MS/VFW/FOURCC")
    return element(0xAE, values + element(0x63A2, bitmap_header(size, codec)) + video)


def camera(purpose: str, k, sensor, crop, T) -> dict:
    k1, k2, p1, p2, k3, k4, k5, k6 = k.distortion or (0.0,) * 8
    centre = (k.cx + crop[0] + 0.5) / sensor[0], (k.cy + crop[1] + 0.5) / sensor[1]
    parameters = [*centre, k.fx / sensor[0], k.fy / sensor[1], k1, k2, k3, k4, k5, k6, 0.0, 0.0, p2, p1]
    return {
        "Intrinsics": {"ModelParameterCount": 14, "ModelParameters": parameters},
        "Purpose": f"CALIBRATION_CameraPurpose{purpose}",
        "Rt": {"Rotation": T[:3, :3].ravel().tolist(), "Translation": T[:3, 3].tolist()},
    }


def write_azure_mkv(
    path: Path, frames, color_k, depth_k, T_color_depth, *, codec: str = "MJPG", depth_delay_ms: int = 0
) -> None:
    """frames: (color (720, 1280, 3) RGB, depth (288, 320) uint16), 30 a second, a cluster each; None for an image that
    the camera lost. The depth is taken so much later, and 2 ms more."""
    cameras = [
        camera("Depth", depth_k, DEPTH_SENSOR, DEPTH_CROP, np.eye(4)),
        camera("PhotoVideo", color_k, COLOR_SENSOR, COLOR_CROP, T_color_depth),
    ]
    calibration = json.dumps({"CalibrationInformation": {"Cameras": cameras}}).encode() + b"\0"
    tag = element(0x45A3, b"K4A_CALIBRATION_FILE") + element(0x4487, b"calibration.json")
    attached = element(0x466E, b"calibration.json") + element(0x4660, b"application/octet-stream")
    segment = element(0x1549A966, number(0x2AD7B1, 1_000_000))
    segment += element(0x1654AE6B, track(1, "COLOR", COLOR_SIZE, codec) + track(2, "DEPTH", DEPTH_SIZE, "b16g"))
    delay = element(0x45A3, b"K4A_DEPTH_DELAY_NS") + element(0x4487, str(depth_delay_ms * 1_000_000).encode())
    segment += element(0x1254C367, b"".join(element(0x7373, element(0x67C8, one)) for one in (tag, delay)))
    segment += element(0x1941A469, element(0x61A7, attached + element(0x465C, calibration)))
    for i, (color, depth) in enumerate(frames):
        cluster = number(0xE7, round(1000 * i / 30))
        if color is None:
            data = None
        elif codec == "MJPG":
            data = cv2.imencode(".jpg", color[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
        else:
            planes = cv2.cvtColor(color, cv2.COLOR_RGB2YUV_I420)
            rows = color.shape[0]
            chroma = planes[rows:].reshape(2, -1)
            data = planes[:rows].tobytes() + np.ascontiguousarray(chroma.T).tobytes()
        if data is not None:
            cluster += element(0xA3, b"\x81\0\0\x80" + data)
        if depth is not None:
            # The depth's block is in a group.
            late = (depth_delay_ms + 2).to_bytes(2, "big")
            cluster += element(0xA0, element(0xA1, b"\x82" + late + b"\0" + depth.astype(">u2").tobytes()))
        segment += element(0x1F43B675, cluster)
    # A file that is still being written does not know its size.
    unknown = b"\x18\x53\x80\x67\x01" + b"\xff" * 7
    path.write_bytes(element(0x1A45DFA3, element(0x4282, b"matroska")) + unknown + segment)
