"""A rig: the calibrated sensors of a recording and where they are. calibration/README.md describes the file format."""

import json
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RigError
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.files.strict_yaml import Item, read_yaml
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

FORMAT, VERSION, UNITS, FRAME = "adagmm-rig", 1, "metre", "RDF"
# Sensor names are folder names in a recording and entity names in the viewer.
SENSOR_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """One sensor of a rig.

    Attributes
    ----------
    intrinsics : of the pixel grid that colour and depth share.
    depth_scale : depth units per metre.
    T_rig_sensor : (4, 4), camera frame (RDF, metres) to rig frame; None where it is not known.

    Raises
    ------
    RigError  for a bad name or depth scale, or a T_rig_sensor that is not rigid.
    """

    name: str
    intrinsics: PinholeIntrinsics
    depth_scale: float
    T_rig_sensor: np.ndarray | None

    def __post_init__(self):
        if not SENSOR_NAME.fullmatch(self.name):
            raise RigError(f"sensor name: expected letters, digits, _ - and . (not first), got {self.name!r}")
        if not (np.isfinite(self.depth_scale) and self.depth_scale > 0):
            raise RigError(f"{self.name}: depth_scale: expected positive depth units per metre, got {self.depth_scale}")
        if self.T_rig_sensor is not None:
            try:
                T = checked_rigid_transformation(self.T_rig_sensor, f"{self.name}: T_rig_sensor")
            except InputError as problem:
                raise RigError(str(problem)) from problem
            object.__setattr__(self, "T_rig_sensor", T)


@dataclass(frozen=True, eq=False)
class Rig:
    """Named sensors in one rig frame, in metres. `path` is the file it came from, for messages."""

    name: str
    sensors: dict[str, SensorCalibration]
    description: str = ""
    path: Path | None = field(default=None)

    def __post_init__(self):
        if not self.sensors:
            raise RigError(f"{self.label}: expected at least one sensor, got none")
        for key, sensor in self.sensors.items():
            if key != sensor.name:
                raise RigError(f"{self.label}: sensor {sensor.name!r} is listed under the name {key!r}")

    @property
    def label(self) -> str:
        """What messages call this rig: its file, or its name."""
        return str(self.path) if self.path else f"rig {self.name}"

    def sensor(self, name: str) -> SensorCalibration:
        """Raises RigError, naming the sensors there are, if there is none of that name."""
        if name not in self.sensors:
            raise RigError(f"{self.label}: no sensor {name!r}; this rig has {', '.join(self.sensors)}")
        return self.sensors[name]

    def T_target_source(self, target: str, source: str) -> np.ndarray:
        """(4, 4), from the source sensor's camera frame to the target's.

        Raises
        ------
        RigError  if the rig lacks one of the two sensors, or where one of them is.
        """
        return se_inverse(self._known_pose(target)) @ self._known_pose(source)

    def _known_pose(self, name: str) -> np.ndarray:
        T_rig_sensor = self.sensor(name).T_rig_sensor
        if T_rig_sensor is None:
            raise RigError(f"{self.label}: T_rig_sensor of sensor {name!r} is unknown; calibrate the rig first")
        return T_rig_sensor


def load_rig(path: str | Path) -> Rig:
    """Read a rig file.

    Raises
    ------
    RigError  naming the file, the line, what was wanted and what is there.
    """
    path = Path(path)
    keys = read_yaml(path, RigError).mapping(
        required=("format", "version", "name", "units", "frame", "sensors"), optional=("description",)
    )
    keys["format"].literal(FORMAT)
    keys["version"].literal(str(VERSION))
    keys["units"].literal(UNITS)
    keys["frame"].literal(FRAME)
    sensors = {name: _read_sensor(name, item) for name, item in keys["sensors"].mapping().items()}
    if not sensors:
        keys["sensors"].fail("expected at least one sensor, got none")
    description = keys["description"].text() if "description" in keys else ""
    return Rig(keys["name"].text(), sensors, description, path)


def save_rig(path: str | Path, rig: Rig) -> None:
    """Write a rig file that load_rig reads back equal to the last bit. Raises OutputError if it cannot be written."""
    lines = [f"format: {FORMAT}", f"version: {VERSION}", f"name: {_quoted(rig.name)}"]
    if rig.description:
        lines.append(f"description: {_quoted(rig.description)}")
    lines += [
        f"units: {UNITS}  # of T_rig_sensor",
        f"frame: {FRAME}  # cameras: x right, y down, z forward",
        "sensors:",
    ]
    for name, sensor in rig.sensors.items():
        k = sensor.intrinsics
        lines += [
            f"  {_quoted(name)}:",
            f"    intrinsics: {{width: {k.width}, height: {k.height}, fx: {k.fx!r}, fy: {k.fy!r}, "
            f"cx: {k.cx!r}, cy: {k.cy!r}}}",
        ]
        lines.append(f"    distortion: [{', '.join(map(repr, k.distortion))}]")
        lines.append(f"    depth_scale: {float(sensor.depth_scale)!r}  # depth units per metre")
        if sensor.T_rig_sensor is None:
            lines.append("    T_rig_sensor: unknown")
        else:
            lines.append("    T_rig_sensor:")
            lines += [f"      - [{', '.join(repr(float(x)) for x in row)}]" for row in sensor.T_rig_sensor]
    write_text(path, "\n".join(lines) + "\n")


def _read_sensor(name: str, item: Item) -> SensorCalibration:
    keys = item.mapping(required=("intrinsics", "depth_scale", "T_rig_sensor"), optional=("distortion",))
    sizes = keys["intrinsics"].mapping(required=("width", "height", "fx", "fy", "cx", "cy"))
    if not SENSOR_NAME.fullmatch(name):
        item.fail(f"expected a name of letters, digits, _ - and . (not first), got {name!r}")
    try:
        intrinsics = PinholeIntrinsics(
            sizes["width"].integer(),
            sizes["height"].integer(),
            sizes["fx"].number(),
            sizes["fy"].number(),
            sizes["cx"].number(),
            sizes["cy"].number(),
            distortion=keys["distortion"].numbers() if "distortion" in keys else (),
        )
    except RigError:
        raise
    except InputError as problem:
        keys["intrinsics"].fail(str(problem).removeprefix("intrinsics."))
    depth_scale = keys["depth_scale"].number()
    if depth_scale <= 0:
        keys["depth_scale"].fail(f"expected positive depth units per metre, got {depth_scale:g}")
    return SensorCalibration(name, intrinsics, depth_scale, _read_extrinsics(keys["T_rig_sensor"]))


def _read_extrinsics(item: Item) -> np.ndarray | None:
    if item.value == "unknown":
        return None
    T = item.matrix(4, 4)
    try:
        return checked_rigid_transformation(T, "T_rig_sensor")
    except InputError as problem:
        item.fail(str(problem).removeprefix("T_rig_sensor: "))


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)  # a JSON string is a YAML string
