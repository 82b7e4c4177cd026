"""Other programs' files that hold a whole rig, told apart by their names and first bytes."""

from pathlib import Path

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.input_file import is_given, read_input
from adagmm_fusion.formats.matlab_file import read_variable, variable_names
from adagmm_fusion.rigs.colmap import read_colmap
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_fusion.rigs.kalibr import read_kalibr
from adagmm_fusion.rigs.matlab_parameters import VARIABLE, stereo_parameters
from adagmm_fusion.rigs.matlab_stereo import read_matlab_stereo
from adagmm_fusion.rigs.multical import read_multical
from adagmm_fusion.rigs.open3d_cameras import read_open3d_cameras
from adagmm_fusion.rigs.ros_bag_rig import read_ros_bag_rig

BAGS = (".bag", ".db3", ".mcap")


def read_rig_file(
    path: str | Path, metres_per_unit: float = 1.0, size: tuple[int, int] | None = None
) -> dict[str, ImportedSensor]:
    """The sensors of a rig by name; the first one's frame is the rig's.

    Parameters
    ----------
    metres_per_unit : of the lengths in it, but for a ROS bag's, which are in metres.    size : (width, height), for the
        Camera Calibration Toolbox's.

    Raises
    ------
    RigError  naming the file, and what is missing or wrong, or that it is none of these.
    """
    path = Path(path)
    if path.is_dir() and is_given(path / "cameras.txt"):
        return read_colmap(path, metres_per_unit)
    suffix = path.suffix.lower()
    if suffix in BAGS or (path.is_dir() and is_given(path / "metadata.yaml")):
        return read_ros_bag_rig(path)
    if suffix == ".mat":
        return _read_matlab(path, metres_per_unit, size)
    start = read_input(path, RigError, count=4096)
    if suffix in (".yaml", ".yml") and b"cam0" in start:
        return read_kalibr(path, metres_per_unit)
    if suffix == ".json" and b'"camera_poses"' in read_input(path, RigError):
        return read_multical(path, metres_per_unit)
    if suffix == ".json" and (b"extrinsic" in start or b"PinholeCamera" in start):
        return read_open3d_cameras(path, metres_per_unit)
    raise RigError(
        f"{path}: expected Kalibr's camchain, Open3D's camera trajectory, COLMAP's folder, multical's "
        "calibration.json, a MATLAB stereo calibration or a ROS bag; the calibration of one camera is given as "
        "SENSOR=FILE, OpenCV's of two in one file as left=FILE right=FILE --stereo FILE"
    )


def _read_matlab(path: Path, metres_per_unit: float, size: tuple[int, int] | None) -> dict[str, ImportedSensor]:
    """MATLAB's own stereoParameters, or those of the Camera Calibration Toolbox."""
    try:
        if VARIABLE not in variable_names(path):
            return read_matlab_stereo(path, metres_per_unit, size)
        return stereo_parameters(path, read_variable(path, VARIABLE), metres_per_unit)
    except RecordingError as problem:
        raise RigError(str(problem)) from problem
