"""A calibration that lies in a folder of a data set whose camera is known: it counts in place of the data set's."""

from collections.abc import Iterable
from pathlib import Path

from adagmm_fusion.files.image_files import first_readable, image_size
from adagmm_fusion.files.input_file import is_given
from adagmm_fusion.formats.camera_files import find_camera_files, read_camera_file
from adagmm_fusion.formats.folder_cameras import FolderCameras, find_cameras
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
    known, depth_scale : what the data set says.    depths : depth images, one at least, on the colour camera's grid.
    beside : a file that counts where the folder has none.

    Raises
    ------
    RecordingError  if a camera file cannot be used, or two of them disagree, or nothing knows the intrinsics.
    RigError  as ReadOptions.calibration.
    """
    found = FolderCameras()
    if options.rig is None:
        if find_camera_files(folder):
            size = first_readable(depths, image_size)
            found = find_cameras(folder, size, size)
        elif beside is not None and is_given(beside) and (camera := read_camera_file(beside)) is not None:
            size = first_readable(depths, image_size)
            doubt = camera.doubt((size,))
            found = FolderCameras(camera, depth_scale=camera.depth_scale, notes=() if doubt is None else (doubt,))
    if found.color is None:
        return *options.calibration(sensor, known, depth_scale, folder), found.notes
    notes = [f"the intrinsics are those of {found.color.path.name}", *found.notes]
    if found.depth is not None:
        notes.append(f"{found.depth.path.name} is not used: this format's depth is registered to the colour image")
    return found.color.intrinsics((size,)), found.depth_scale or depth_scale, tuple(notes)
