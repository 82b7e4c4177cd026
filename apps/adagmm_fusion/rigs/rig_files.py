"""Other programs' files that hold a whole rig, told apart by their names and first bytes."""

from pathlib import Path

from adagmm_fusion.errors import RigError
from adagmm_fusion.files.input_file import read_input
from adagmm_fusion.rigs.colmap import read_colmap
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_fusion.rigs.kalibr import read_kalibr
from adagmm_fusion.rigs.matlab_stereo import read_matlab_stereo
from adagmm_fusion.rigs.open3d_cameras import read_open3d_cameras
from adagmm_fusion.rigs.ros_bag_rig import read_ros_bag_rig

BAGS = (".bag", ".db3", ".mcap")


def read_rig_file(
    path: str | Path, metres_per_unit: float = 1.0, size: tuple[int, int] | None = None
) -> dict[str, ImportedSensor]:
    """The sensors of a rig by name; the first one's frame is the rig's.

    Parameters
    ----------
    metres_per_unit : of COLMAP's and MATLAB's lengths, which have no unit.    size : (width, height), for MATLAB's.

    Raises
    ------
    RigError  naming the file, and what is missing or wrong, or that it is none of these.
    """
    path = Path(path)
    if path.is_dir() and (path / "cameras.txt").is_file():
        return read_colmap(path, metres_per_unit)
    suffix = path.suffix.lower()
    if suffix in BAGS or (path.is_dir() and (path / "metadata.yaml").is_file()):
        return read_ros_bag_rig(path)
    if suffix == ".mat":
        return read_matlab_stereo(path, metres_per_unit, size)
    start = read_input(path, RigError, count=4096)
    if suffix in (".yaml", ".yml") and b"cam0" in start:
        return read_kalibr(path)
    if suffix == ".json" and (b"extrinsic" in start or b"PinholeCamera" in start):
        return read_open3d_cameras(path)
    raise RigError(
        f"{path}: expected Kalibr's camchain, Open3D's camera trajectory, COLMAP's folder, a MATLAB stereo calibration "
        "or a ROS bag; the calibration of one camera is given as SENSOR=FILE"
    )
