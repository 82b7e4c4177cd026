"""`adagmm-fusion convert-rig`: calibrations of other programs as a rig file."""

import argparse
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

from adagmm_fusion.processes.terminal import printable

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001}
DEPTH_SCALE = 1000.0
# Sensors that see the same surfaces are not this far apart [m]; in millimetres nearly all rigs are.
FAR_M = 20.0


def add(commands: argparse._SubParsersAction) -> None:
    text = (
        "Make a rig file of calibrations that ROS (camera_info YAML) or OpenCV (FileStorage) wrote, or of one file of "
        "all cameras: Kalibr's camchain, Open3D's camera trajectory, COLMAP's text model, multical's calibration.json, "
        "a MATLAB stereo calibration, or a ROS bag. The first sensor is the rig's frame. Where the others are comes "
        "from --stereo, or from the rectification that ROS files hold; else it is unknown."
    )
    command = commands.add_parser(
        "convert-rig", help="make a rig file of other programs' calibrations", description=text
    )
    command.add_argument(
        "sensors", nargs="+", metavar="SENSOR=FILE", help="a sensor's name and its calibration; or one file"
    )
    command.add_argument("--output", required=True, metavar="RIG", help="the rig file to write")
    command.add_argument("--stereo", metavar="FILE", help="an OpenCV file with R, T of two sensors: x2 = R x1 + T")
    command.add_argument(
        "--length-unit",
        choices=tuple(METRES_PER_UNIT),
        default="m",
        help="of the lengths in the files (default: %(default)s)",
    )
    command.add_argument("--size", metavar="WxH", help="image size, for OpenCV files without it")
    command.add_argument(
        "--depth-scale",
        type=float,
        metavar="UNITS",
        help=f"depth units per metre (default: what the calibration says, else {DEPTH_SCALE:g})",
    )
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the rig file; returns the exit code.

    Raises
    ------
    AdaGMMError  if a calibration cannot be used, or the rig file cannot be written.
    """
    from adagmm_fusion.board_calibration.boards import parse_board_size
    from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig
    from adagmm_fusion.rigs.rig_files import read_rig_file

    size = parse_board_size(args.size, "--size") if args.size else None
    metres_per_unit = METRES_PER_UNIT[args.length_unit]
    if len(args.sensors) == 1 and "=" not in args.sensors[0] and Path(args.sensors[0]).exists():
        found = read_rig_file(args.sensors[0], metres_per_unit, size)
    else:
        found = _one_by_one(args, size, metres_per_unit)
    output = Path(args.output)
    sensors = {
        name: SensorCalibration(name, sensor.intrinsics, _depth_scale(args, sensor), sensor.T_rig_sensor)
        for name, sensor in found.items()
    }
    save_rig(output, Rig(output.stem, sensors, f"from {', '.join(args.sensors)}"))
    if (far := _far_apart(found)) is not None:
        _note(far)
    unknown = [name for name, sensor in found.items() if sensor.T_rig_sensor is None]
    pose = f"; the pose of {', '.join(unknown)} is unknown" if unknown else ""
    print(printable(f"{output}: {', '.join(found)}{pose}"))
    return 0


def _depth_scale(args: argparse.Namespace, sensor: Any) -> float:
    if args.depth_scale is not None:
        return args.depth_scale
    return DEPTH_SCALE if sensor.depth_scale is None else sensor.depth_scale


def _far_apart(found: dict[str, Any]) -> str | None:
    """What to say of sensors whose distance looks like one in millimetres, or None."""
    import numpy as np

    at = {name: sensor.T_rig_sensor[:3, 3] for name, sensor in found.items() if sensor.T_rig_sensor is not None}
    apart = [(float(np.linalg.norm(at[a] - at[b])), a, b) for a, b in combinations(at, 2)]
    metres, a, b = max(apart, default=(0.0, "", ""))
    if metres <= FAR_M:
        return None
    units = ["cm", "mm"] if metres <= FAR_M / METRES_PER_UNIT["cm"] else ["mm"]
    said = " or ".join(f"--length-unit {unit} ({metres * METRES_PER_UNIT[unit]:.3g} m)" for unit in units)
    return f"{a} and {b} are {metres:.0f} m apart, which looks like another unit taken for metres; try {said}"


def _note(text: str) -> None:
    print(printable(f"adagmm-fusion: {text}"), file=sys.stderr)


def _one_by_one(args: argparse.Namespace, size: tuple[int, int] | None, metres_per_unit: float) -> dict[str, Any]:
    """The sensors that SENSOR=FILE name, each a camera's calibration, and where they are, if that is known."""
    import numpy as np

    from adagmm_fusion.rigs.imported import ImportedSensor
    from adagmm_fusion.rigs.importing import read_camera, read_stereo_pose
    from adagmm_fusion.rigs.plain_json import read_plain_json
    from adagmm_o3d.errors import InputError
    from adagmm_o3d.lie import se_inverse

    cameras = {}
    for number, text in enumerate(args.sensors, 1):
        name, equals, path = text.partition("=")
        if not equals and not Path(text).exists():
            raise InputError(f"SENSOR=FILE: {text}: there is no such file")
        if not (name and equals and path) or name in cameras:
            raise InputError(f"SENSOR=FILE: expected different names as left=left.yaml, got {text!r}")
        plain = read_plain_json(Path(path), size, name)
        cameras[name], note = (read_camera(path, number, size), None) if plain is None else plain
        if note is not None:
            _note(note)
    first, *others = cameras
    poses = dict.fromkeys(cameras) | {first: np.eye(4)}
    if args.stereo:
        if len(others) != 1:
            raise InputError(f"--stereo: expected two sensors, got {len(cameras)}")
        poses[others[0]] = read_stereo_pose(args.stereo, metres_per_unit)
    elif all(camera.T_stereo_camera is not None for camera in cameras.values()):
        T_first = se_inverse(cameras[first].T_stereo_camera)
        placed = {name: T_first @ cameras[name].T_stereo_camera for name in others}
        # Cameras calibrated one by one all have their own rectification, with no distance between them.
        if all(np.linalg.norm(T[:3, 3]) > 0 for T in placed.values()):
            poses |= placed
    return {
        name: ImportedSensor(camera.intrinsics, poses[name], camera.depth_scale) for name, camera in cameras.items()
    }
