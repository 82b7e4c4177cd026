"""A calibration that lies in a folder of a data set whose camera is known: it counts in place of the data set's."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import image_size
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.formats.camera_files import find_camera_files, read_camera_file
from adagmm_fusion.formats.options import ReadOptions
from adagmm_fusion.frames.rgbd import PinholeIntrinsics


def calibration_with_own(
    folder: Path,
    options: ReadOptions,
    sensor: str,
    known: PinholeIntrinsics | None,
    depth_scale: float,
    depths: Iterable[Path],
    *,
    beside: Path | None = None,
) -> tuple[PinholeIntrinsics, float, tuple[str, ...]]:
    """The rig's intrinsics and depth scale, else those of a camera file in the folder, else the data set's; and notes.

    Parameters
    ----------
    known, depth_scale : what the data set says.    depths : depth images, for the size where the file has none.
    beside : a file that counts where the folder has none.

    Raises
    ------
    RecordingError  if a camera file cannot be used, or two of them disagree, or nothing knows the intrinsics.
    RigError  as ReadOptions.calibration.
    """
    if options.rig is not None:
        return *options.calibration(sensor, known, depth_scale, folder), ()
    cameras = [camera for path in find_camera_files(folder) if (camera := read_camera_file(path)) is not None]
    if not cameras and beside is not None and is_given(beside):
        cameras = [camera for camera in [read_camera_file(beside)] if camera is not None]
    if not cameras:
        return *options.calibration(sensor, known, depth_scale, folder), ()
    first, *others = cameras
    for other in others:
        if not np.array_equal(first.K, other.K) or first.distortion != other.distortion:
            raise RecordingError(
                f"{other.path}: expected the camera matrix and distortion of {first.path.name}, got others; keep one "
                "of the two files, or give a rig file"
            )
    there = next((path for path in depths if path.exists()), None)
    if first.size is None and there is None:
        raise RecordingError(f"{folder}: expected depth images, got none; {first.path.name} does not say their size")
    sizes = (first.size or image_size(there),)
    notes = [f"the intrinsics are those of {first.path.name}"]
    if (doubt := first.doubt(sizes)) is not None:
        notes.append(doubt)
    return first.intrinsics(sizes), first.depth_scale or depth_scale, tuple(notes)
