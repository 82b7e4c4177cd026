"""Kalibr's camchain YAML (kalibr_calibrate_cameras): all cameras of a rig.

cam0, cam1, ...
    camera_model: pinhole
    intrinsics: [fx, fy, cx, cy]
    distortion_model: radtan, or none          distortion_coeffs: [k1, k2, p1, p2]
    resolution: [width, height]
    T_cn_cnm1: 4x4, camera n - 1 to camera n, metres as Kalibr writes it; not of cam0
"""

from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RigError
from adagmm_fusion.files.strict_yaml import Item, read_yaml
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_fusion.rigs.imported import ImportedSensor
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

LENSES = ("radtan", "none")


def read_kalibr(path: Path, metres_per_unit: float = 1.0) -> dict[str, ImportedSensor]:
    """The cameras by name, in cam0's frame. Raises RigError naming file, line and what is wrong."""
    sensors: dict[str, ImportedSensor] = {}
    T_rig_last = np.eye(4)
    for name, item in read_yaml(path, RigError).mapping().items():
        keys = item.mapping()
        if not name.startswith("cam"):
            item.fail("expected cameras called cam0, cam1, ... as in Kalibr's camchain")
        if sensors and "T_cn_cnm1" not in keys:
            item.fail("key 'T_cn_cnm1' is missing: the camera is not calibrated against the one before")
        if sensors:
            T_rig_last = T_rig_last @ se_inverse(_pose(keys["T_cn_cnm1"], metres_per_unit))
        sensors[name] = ImportedSensor(_intrinsics(item, keys), T_rig_last)
    return sensors


def _pose(item: Item, metres_per_unit: float) -> np.ndarray:
    T = item.matrix(4, 4)
    T[:3, 3] *= metres_per_unit
    try:
        return checked_rigid_transformation(T, "T_cn_cnm1")
    except RigError:
        raise
    except InputError as problem:
        item.fail(str(problem))


def _intrinsics(item: Item, keys: dict[str, Item]) -> PinholeIntrinsics:
    for key in ("camera_model", "intrinsics", "resolution", "distortion_model", "distortion_coeffs"):
        if key not in keys:
            item.fail(f"key {key!r} is missing")
    keys["camera_model"].literal("pinhole")
    coefficients, lens = keys["distortion_coeffs"].numbers(), keys["distortion_model"]
    if lens.text() not in LENSES and any(coefficients):
        lens.fail(f"expected {' or '.join(LENSES)}, got {lens.value}; calibrate with pinhole-radtan")
    values, size = keys["intrinsics"].numbers(), keys["resolution"].sequence()
    if len(values) != 4 or len(size) != 2:
        item.fail("expected intrinsics of 4 numbers and a resolution of 2")
    distortion = coefficients if any(coefficients) else ()
    try:
        return PinholeIntrinsics(size[0].integer(), size[1].integer(), *values, distortion=distortion)
    except RigError:
        raise
    except InputError as problem:
        item.fail(str(problem))
