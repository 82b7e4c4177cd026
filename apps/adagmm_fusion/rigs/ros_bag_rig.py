"""The cameras of a ROS bag as a rig: camera_info and the static transforms."""

from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.formats.ros_cameras import RosBag
from adagmm_fusion.rigs.imported import ImportedSensor


def read_ros_bag_rig(path: Path) -> dict[str, ImportedSensor]:
    """The colour cameras by name, in the first one's frame. Raises RigError naming what is missing or damaged."""
    try:
        bag = RosBag(path)
        first = bag.cameras[0]
        sensors = {}
        for camera in bag.cameras:
            intrinsics = bag.intrinsics(camera)
            if intrinsics is None:
                raise RecordingError(f"{path}: {camera.color_info} is missing")
            pose = np.eye(4) if camera is first else bag.T_color(first, camera)
            sensors[camera.name] = ImportedSensor(intrinsics, pose)
    except RecordingError as problem:
        raise RigError(str(problem)) from problem
    return sensors
