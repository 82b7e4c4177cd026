"""One Azure Kinect .mkv file, through Open3D's reader, which registers the depth to the colour image.

Open3D's Python interface tells neither intrinsics nor frame rate nor times, so a rig is needed, 30 frames a second are
taken, and a frame has the time it was sought at. Depth is in millimetres. Open3D needs libk4a and libk4arecord, which
it does not bring along.
"""

import math
import re
from pathlib import Path

import numpy as np
import open3d as o3d

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import check_input

MAX_FRAMES = 1_000_000  # nine hours; a damaged file may tell of centuries


class MKVStream:
    """Colour and depth of one camera, by the number of a frame.    times : (n,) of the frames [s].

    Raises
    ------
    RecordingError  if the libraries are missing, or the file is no such recording.
    """

    fps, depth_scale, intrinsics = 30.0, 1000.0, None
    notes = ()

    def __init__(self, path: str) -> None:
        self.path = path
        check_input(Path(path), RecordingError)
        try:
            self._reader = o3d.io.AzureKinectMKVReader()
        except AttributeError as problem:
            raise RecordingError(f"{path}: this build of Open3D has no reader for it; use another build") from problem
        try:
            with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
                opened = self._reader.open(path)
        except RuntimeError as problem:
            reason = re.search(r":\d+: ([^\n]*)", str(problem))  # behind the place in Open3D's source
            raise RecordingError(
                f"{path}: Open3D cannot read such files here: {reason[1] if reason else problem}; "
                "install libk4a and libk4arecord 1.4"
            ) from problem
        if not opened:
            raise RecordingError(f"{path}: Open3D cannot open it; it is missing, cut off or not a camera's recording")
        count = max(1, math.floor(self._reader.get_metadata().stream_length_usec / 1e6 * self.fps + 1e-6))
        if count > MAX_FRAMES:
            raise RecordingError(f"{path}: expected at most {MAX_FRAMES} frames, by its length it has {count}")
        self.times = np.arange(count) / self.fps

    def at(self, index: int) -> tuple[np.ndarray, np.ndarray, float]:
        """RGB (H, W, 3), depth (H, W) and time [s] of the first whole frame from the time of a frame on."""
        seconds = float(self.times[index])
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            sought = self._reader.seek_timestamp(round(1e6 * seconds))
            while sought and not self._reader.is_eof():
                frame = self._reader.next_frame()
                if frame is None:  # a file may hold captures without colour or without depth
                    continue
                color, depth = np.array(frame.color), np.array(frame.depth)  # the reader uses its own memory again
                if color.size and depth.size:
                    return np.ascontiguousarray(color[..., :3]), depth.reshape(depth.shape[:2]), seconds
        raise RecordingError(f"{self.path}: no frame with colour and depth at {seconds:.3f} s or later")
