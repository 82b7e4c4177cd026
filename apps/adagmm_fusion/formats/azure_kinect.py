"""One Azure Kinect .mkv as k4arecorder writes it, without Microsoft's libraries.

    track COLOR          MJPG, or NV12 or YUY2 as they are
    track DEPTH          b16g: 16 bit, the high byte first, millimetres, of the depth camera
    tag K4A_DEPTH_MODE   NFOV_UNBINNED, ...
    tag K4A_DEPTH_DELAY_NS  how much later than the colour of its capture the depth is taken
    calibration.json     attached: CalibrationInformation, Cameras: of each its Purpose, Rt (depth camera to this one,
                         metres) and 14 ModelParameters: cx cy fx fy as shares of the sensor's width and height,
                         k1 to k6, codx, cody, p2, p1

A mode shows a part of the sensor, smaller; they are here as in the SDK's mode_specific_calibration.c. Depth is
registered to the colour image. Source: Azure-Kinect-Sensor-SDK, its record format page.
"""

import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import decoded_color
from adagmm_fusion.files.json_file import json_numbers, json_object, parse_json
from adagmm_fusion.files.matroska_file import MatroskaFile, Track
from adagmm_fusion.formats.text_table import parse_pose
from adagmm_fusion.frames.depth_registration import register_depth
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_o3d.errors import InputError

CALIBRATION, DEPTH_DELAY = "calibration.json", "K4A_DEPTH_DELAY_NS"
# (width, height) of the picture: of the whole sensor at this resolution, and where the picture begins in it.
COLOR_MODES = {
    (1280, 720): ((1280, 960), (0, 120)),
    (1920, 1080): ((1920, 1440), (0, 180)),
    (2560, 1440): ((2560, 1920), (0, 240)),
    (2048, 1536): ((2048, 1536), (0, 0)),
    (3840, 2160): ((3840, 2880), (0, 360)),
    (4096, 3072): ((4096, 3072), (0, 0)),
}
DEPTH_MODES = {
    (320, 288): ((512, 512), (96, 90)),
    (640, 576): ((1024, 1024), (192, 180)),
    (512, 512): ((512, 512), (0, 0)),
    (1024, 1024): ((1024, 1024), (0, 0)),
}
YUV = {"NV12": (cv2.COLOR_YUV2RGB_NV12, 3, 2), "YUY2": (cv2.COLOR_YUV2RGB_YUY2, 2, 1)}
DEPTH_CODEC = "b16g"


def _captures(depth: np.ndarray, color: np.ndarray, interval: float) -> np.ndarray:
    """(n, 2) the numbers of a depth image and of a colour image of one capture: by their times [ns] nearest to each
    other, and less than half an `interval` apart."""
    found, back = _nearest(depth, color), _nearest(color, depth)
    own = np.arange(len(depth))
    both = (back[found] == own) & (2 * np.abs(color[found] - depth) < interval)
    return np.stack([own, found], axis=1)[both]


def _nearest(times: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(n,) for each time the number of the nearest of the others, of equally near ones the earlier."""
    order = np.argsort(others, kind="stable")
    ordered = others[order]
    after = np.clip(np.searchsorted(ordered, times), 1, max(1, len(others) - 1))
    before = after - 1
    after = np.minimum(after, len(others) - 1)
    return order[np.where(times - ordered[before] <= ordered[after] - times, before, after)]


class AzureKinectStream:
    """Colour and depth of one camera, a frame for each capture that has both; depth is registered to the colour image.

    intrinsics : of the colour image.    depth_scale : units per metre.    fps : of the depth.
    times : (n,) of the frames' depth images [s], from the first one.    notes : how many captures lack an image.

    Raises
    ------
    RecordingError  if the file is no such recording, or damaged.
    """

    depth_scale = 1000.0

    def __init__(self, path: str) -> None:
        self.path = path
        self._file = MatroskaFile(Path(path))
        self._color, self._depth = self._track("COLOR"), self._track("DEPTH")
        if self._depth.codec != DEPTH_CODEC or self._color.codec not in ("MJPG", *YUV):
            raise RecordingError(
                f"{path}: expected colour as MJPG, NV12 or YUY2 and depth as b16g, got {self._color.codec!a} and "
                f"{self._depth.codec!a}"
            )
        cameras = self._cameras()
        self.intrinsics = self._intrinsics(cameras["PhotoVideo"], self._color, COLOR_MODES)
        self._depth_intrinsics = self._intrinsics(cameras["Depth"], self._depth, DEPTH_MODES)
        self._T_color_depth = self._pose(cameras["PhotoVideo"])
        times = np.array([time for time, *_ in self._depth.blocks])
        color_times = np.array([time for time, *_ in self._color.blocks])
        apart = np.diff(times) if len(times) > 1 else np.array([1e9 / 30])
        if np.median(apart) <= 0:
            raise RecordingError(f"{path}: its depth images are not in the order of time")
        # Where images are missing the next one is farther off.
        interval = float(np.quantile(apart[apart > 0], 0.1, method="lower"))
        self.fps = float(min((5, 15, 30), key=lambda fps: abs(1e9 / fps - interval)))
        self._captures = _captures(times - self._depth_delay_ns(), color_times, 1e9 / self.fps)
        if not len(self._captures):
            raise RecordingError(f"{path}: no depth image has a colour image within {500 / self.fps:.0f} ms of it")
        self.times = (times[self._captures[:, 0]] - times[0]) / 1e9
        missing = [len(images) - len(self._captures) for images in (times, color_times)]
        self.notes = tuple(
            f"{count} {own} without {other} of the same capture: left out"
            for count, own, other in zip(missing, ("depth images", "colour images"), ("colour", "depth"), strict=True)
            if count
        )

    def at(self, index: int) -> tuple[np.ndarray, np.ndarray, float]:
        """RGB (H, W, 3), depth (H, W) and time [s] of a frame.

        Raises
        ------
        RecordingError  if an image is damaged.
        """
        of_depth, of_color = (int(number) for number in self._captures[index])
        depth = self._depth_image(of_depth)
        registered = register_depth(
            depth, self._depth_intrinsics, self.intrinsics, self._T_color_depth, self.depth_scale
        )
        return self._color_image(of_color), np.floor(registered + 0.5).astype(np.uint16), float(self.times[index])

    def _depth_delay_ns(self) -> int:
        """How much later than the colour the depth is taken by intent."""
        text = self._file.tags.get(DEPTH_DELAY, "0")
        if not re.fullmatch(r"-?\d{1,12}", text):
            raise RecordingError(f"{self.path}: {DEPTH_DELAY}: expected nanoseconds, got {text[:40]!a}")
        return int(text)

    def _track(self, name: str) -> Track:
        track = self._file.tracks.get(name)
        if track is None or not track.blocks:
            raise RecordingError(f"{self.path}: there is no image in its track {name}; record colour and depth")
        return track

    def _cameras(self) -> dict[str, dict[str, Any]]:
        name = self._file.tags.get("K4A_CALIBRATION_FILE", CALIBRATION)
        if name not in self._file.attachments:
            raise RecordingError(f"{self.path}: the calibration is not attached; it was not recorded by k4arecorder")
        where = f"{self.path}: {CALIBRATION}"
        data = self._file.attachments[name].rstrip(b"\0")
        information = json_object(parse_json(data, Path(where)), where).get("CalibrationInformation")
        listed = json_object(information, where).get("Cameras")
        cameras = {}
        for item in listed if isinstance(listed, list) else ():
            values = json_object(item, where)
            cameras[str(values.get("Purpose")).removeprefix("CALIBRATION_CameraPurpose")] = values
        for purpose in ("Depth", "PhotoVideo"):
            if purpose not in cameras:
                raise RecordingError(f"{where}: expected a camera of the purpose {purpose}, there is none")
        return cameras

    def _intrinsics(self, camera: dict[str, Any], track: Track, modes: dict) -> PinholeIntrinsics:
        where = f"{self.path}: {CALIBRATION}"
        mode = modes.get((track.width, track.height))
        if mode is None:
            raise RecordingError(f"{self.path}: {track.name}: {track.width}x{track.height} pixels are of no known mode")
        (width, height), (left, top) = mode
        model = json_object(camera.get("Intrinsics"), where)
        p = json_numbers(model.get("ModelParameters"), 14, f"{where}: ModelParameters").tolist()
        cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, _, _, p2, p1 = p
        try:
            return PinholeIntrinsics(
                track.width, track.height, fx * width, fy * height,
                cx * width - left - 0.5, cy * height - top - 0.5, (k1, k2, p1, p2, k3, k4, k5, k6),
            )  # fmt: skip
        except InputError as problem:
            raise RecordingError(f"{where}: {problem}") from problem

    def _pose(self, camera: dict[str, Any]) -> np.ndarray:
        where = f"{self.path}: {CALIBRATION}: Rt"
        values = json_object(camera.get("Rt"), where)
        T = np.eye(4)
        T[:3, :3] = json_numbers(values.get("Rotation"), 9, where).reshape(3, 3)
        T[:3, 3] = json_numbers(values.get("Translation"), 3, where)
        return parse_pose(T, where)

    def _depth_image(self, index: int) -> np.ndarray:
        data, shape = self._file.block(self._depth, index), (self._depth.height, self._depth.width)
        if len(data) != 2 * shape[0] * shape[1]:
            raise RecordingError(f"{self.path}: depth image {index} is not whole")
        return np.frombuffer(data, ">u2").reshape(shape).astype(np.uint16)

    def _color_image(self, index: int) -> np.ndarray:
        data, track = self._file.block(self._color, index), self._color
        if track.codec == "MJPG":
            return decoded_color(data, Path(f"{self.path}: colour image {index}"))
        code, numerator, denominator = YUV[track.codec]
        if len(data) * denominator != numerator * track.width * track.height:
            raise RecordingError(f"{self.path}: colour image {index} is not whole")
        pixels = np.frombuffer(data, np.uint8)
        shape = (track.height * 3 // 2, track.width) if track.codec == "NV12" else (track.height, track.width, 2)
        return cv2.cvtColor(pixels.reshape(shape), code)
