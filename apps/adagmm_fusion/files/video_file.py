"""Single pictures of a video file, by OpenCV."""

import os
from functools import lru_cache
from pathlib import Path

os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # it would print about a damaged file; the error says enough

import cv2
import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.depth_files import MAX_PIXELS
from adagmm_fusion.files.input_file import check_input


class VideoFile:
    """The pictures of a video by number; those that follow each other are read without seeking.

    Raises
    ------
    RecordingError  if it is no video, or damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check_input(path, RecordingError)
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        self._next = 0
        width, height = (self._capture.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if not self._capture.isOpened() or not 0 < width * height <= MAX_PIXELS:
            raise RecordingError(f"{path}: OpenCV cannot open it; it is no video, or cut off or damaged")
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # as the sensor delivered it

    def picture(self, number: int) -> np.ndarray:
        """(H, W, 3) uint8 RGB of the picture with this number, from 0."""
        if number != self._next:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
        there, image = self._capture.read()
        self._next = number + 1
        if not there or image is None:
            self._next = -1
            raise RecordingError(f"{self.path}: there is no picture {number} in it, or it is damaged")
        return np.ascontiguousarray(image[:, :, ::-1])


@lru_cache(maxsize=4)
def open_video(path: Path) -> VideoFile:
    """An open video. It cannot go to another process, so each process opens its own."""
    return VideoFile(path)


def video_picture(path: Path, number: int) -> np.ndarray:
    """(H, W, 3) uint8 RGB of one picture of a video; see VideoFile."""
    return open_video(path).picture(number)
