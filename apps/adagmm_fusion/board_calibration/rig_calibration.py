"""The rig: where its sensors are against each other, from the boards that they saw at the same moments."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from adagmm_fusion.board_calibration.boards import MIN_CORNERS, BoardCorners, Charuco, Chessboard
from adagmm_fusion.board_calibration.sensor import (
    DISTORTION_FLAGS,
    SensorResult,
    calibrate_sensor,
    not_too_many,
    outlying,
)
from adagmm_fusion.board_calibration.views import SensorViews
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, checked_rigid_transformation
from adagmm_fusion.rigs.rig import Rig, SensorCalibration

MIN_COMMON_VIEWS = 3
# Good boards leave an error below a pixel. Above this limit the two sensors do not see the same board.
MAX_RIG_ERROR_PX = 2.0
# A mirrored sensor is named if mirroring it back makes the error this much smaller.
MIRROR_RATIO = 5.0
# Two sensors are refined together if they share this much of the views that either one used.
MIN_COMMON_SHARE = 0.75
DEPTH_SCALE_TOLERANCE, DEPTH_SCALE_LIMIT = 0.02, 0.2


@dataclass(frozen=True, eq=False)
class Link:
    """How a sensor was placed against another one: T_reference_sensor from the views that both saw."""

    sensor: str
    reference: str
    T_reference_sensor: np.ndarray
    rms_px: float
    errors_px: dict[str, float]
    outliers_px: dict[str, float]


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """A rig and what it rests on. `warnings` has one line for each doubt."""

    rig: Rig
    sensors: dict[str, SensorResult]
    links: tuple[Link, ...]
    warnings: tuple[str, ...]


def calibrate_rig(
    views: dict[str, SensorViews],
    board: Chessboard | Charuco,
    *,
    name: str,
    folder: str | Path,
    coefficients: int = 5,
    depth_scale: float = 1000.0,
) -> RigCalibration:
    """Calibrate each sensor, then place all against the first one, whose camera frame is the rig's.

    Parameters
    ----------
    views : by sensor, from find_boards.    folder : for messages.
    coefficients : of the lens distortion, 0, 4, 5 or 8.
    depth_scale : depth units per metre that the rig file shall have, checked where there are depth images.

    Raises
    ------
    RecordingError  naming folder, sensor and views, if the views do not suffice, contradict each other or are mirrored,
        or the depth images have another unit.
    """
    sensors = {key: calibrate_sensor(found, board, coefficients, folder) for key, found in views.items()}
    warnings = [w for result in sensors.values() if (w := _check_depth_scale(result, depth_scale, folder))]
    first = next(iter(sensors))
    placed, links = {first: np.eye(4)}, []
    while len(placed) < len(sensors):
        counts = {
            (sensor, reference): len(_common_views(sensors, sensor, reference))
            for sensor in sensors
            if sensor not in placed
            for reference in placed
        }
        sensor, reference = max(counts, key=counts.get)
        link, used = _link(sensors, board, sensor, reference, folder)
        if len(sensors) == 2 and len(used) >= MIN_COMMON_SHARE * max(len(r.corners) for r in sensors.values()):
            link, sensors = _refined_together(link, used, sensors, board, coefficients)
        placed[sensor] = placed[reference] @ link.T_reference_sensor
        links.append(link)
    calibrations = {
        key: SensorCalibration(key, result.intrinsics, depth_scale, placed[key]) for key, result in sensors.items()
    }
    most = max(len(r.errors_px) for r in sensors.values())
    rig = Rig(name, calibrations, f"calibrated from {most} views of a board")
    return RigCalibration(rig, sensors, tuple(links), tuple(warnings))


def _check_depth_scale(result: SensorResult, depth_scale: float, folder: str | Path) -> str | None:
    """What is to be said about the depth unit, if something is. Raises RecordingError if it is a different one."""
    if result.depth_units_per_metre is None:
        return None
    measured = result.depth_units_per_metre
    off = measured / depth_scale - 1.0
    if abs(off) > DEPTH_SCALE_LIMIT:
        raise RecordingError(
            f"{folder}: {result.name}: the depth images have {measured:.5g} units per metre of the board, not "
            f"{depth_scale:g}; check --depth-scale and the board's square"
        )
    if abs(off) > max(DEPTH_SCALE_TOLERANCE, 3.0 * result.depth_spread / depth_scale):
        longer = "longer" if off > 0 else "shorter"
        return (
            f"{result.name}: depth is {100.0 * abs(off):.1f} % {longer} than the board says; measure the board's "
            f"square again, or use --depth-scale {measured:.5g}"
        )
    return None


def _common_views(
    sensors: dict[str, SensorResult], a: str, b: str
) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Ids and both sensors' pixels, by view that both used."""
    found = {}
    for view, corners in sensors[a].corners.items():
        if view in sensors[b].corners:
            ids, pixels_a, pixels_b = corners.common(sensors[b].corners[view])
            if len(ids) >= MIN_CORNERS:
                found[view] = ids, pixels_a, pixels_b
    return found


def _link(
    sensors: dict[str, SensorResult], board: Chessboard | Charuco, sensor: str, reference: str, folder: str | Path
) -> tuple[Link, dict]:
    """The link, and the views it rests on as _common_views gives them."""
    common = _common_views(sensors, sensor, reference)
    label = f"{folder}: {sensor} and {reference}"
    used = dict(common)
    outliers: dict[str, float] = {}
    while True:
        if len(used) < MIN_COMMON_VIEWS:
            raise RecordingError(
                f"{label}: expected at least {MIN_COMMON_VIEWS} views in which both see the board well, got "
                f"{len(used)}; images of one moment need the same name in both folders"
            )
        rms, T, errors, _ = _stereo(used, sensors[sensor].intrinsics, sensors[reference].intrinsics, board)
        if rms > MAX_RIG_ERROR_PX and _is_mirrored(used, sensors[sensor], sensors[reference], board, rms):
            raise RecordingError(
                f"{label}: the images of one of them are mirrored; switch off the mirroring of the sensor's images"
            )
        errors_px = dict(zip(used, errors, strict=True))
        bad = outlying(errors_px)
        if not bad:
            break
        outliers |= {view: errors_px[view] for view in bad}
        used = {view: seen for view, seen in used.items() if view not in bad}
        not_too_many(label, outliers, len(common))
    if rms > MAX_RIG_ERROR_PX:
        raise RecordingError(
            f"{label}: no rigid rig explains the views, the error is {rms:.1f} px; check that images of the same name "
            "are of the same moment and that the sensors stood still"
        )
    return Link(sensor, reference, T, rms, errors_px, outliers), used


def _refined_together(
    link: Link,
    used: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
    sensors: dict[str, SensorResult],
    board: Chessboard | Charuco,
    coefficients: int,
) -> tuple[Link, dict[str, SensorResult]]:
    """Both sensors' intrinsics once more, with the rig between them: that it is rigid says much about both.

    The sensors' errors and uncertainties stay those of each on its own.
    """
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | DISTORTION_FLAGS[coefficients]
    rms, T, errors, refined = _stereo(
        used, sensors[link.sensor].intrinsics, sensors[link.reference].intrinsics, board, flags
    )
    results = dict(sensors)
    for key, intrinsics in zip((link.sensor, link.reference), refined, strict=True):
        results[key] = replace(sensors[key], intrinsics=intrinsics)
    errors_px = dict(zip(used, errors, strict=True))
    return replace(link, T_reference_sensor=T, rms_px=rms, errors_px=errors_px), results


def _stereo(
    used: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
    sensor: PinholeIntrinsics,
    reference: PinholeIntrinsics,
    board: Chessboard | Charuco,
    flags: int = cv2.CALIB_FIX_INTRINSIC,
) -> tuple[float, np.ndarray, list, list[PinholeIntrinsics]]:
    """RMS [px], T_reference_sensor, each view's error [px] of both sensors together, and their two intrinsics."""
    objects = [board.points[ids].astype(np.float32) for ids, _, _ in used.values()]
    pixels = [[seen[k].astype(np.float32) for seen in used.values()] for k in (1, 2)]
    cameras = [part for k in (sensor, reference) for part in (k.matrix(), np.array(k.distortion or (0.0,) * 4))]
    rms, K1, D1, K2, D2, R, t, _, _, _, _, errors = cv2.stereoCalibrateExtended(
        objects, *pixels, *cameras, (sensor.width, sensor.height), np.eye(3), np.zeros(3), flags=flags
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.ravel(t)
    refined = [
        PinholeIntrinsics(
            *(k.width, k.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2]), tuple(D.ravel()[: len(k.distortion)])
        )
        for k, K, D in ((sensor, K1, D1), (reference, K2, D2))
    ]
    errors_px = np.sqrt(np.mean(np.square(errors), axis=1)).tolist()
    return float(rms), checked_rigid_transformation(T, "stereo calibration"), errors_px, refined


def _is_mirrored(
    used: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
    sensor: SensorResult,
    reference: SensorResult,
    board: Chessboard | Charuco,
    rms: float,
) -> bool:
    """Whether mirroring one sensor back makes the two agree; ChArUco boards tell of themselves."""
    if not isinstance(board, Chessboard):
        return False
    k = sensor.intrinsics
    distortion = [-c if i == 3 else c for i, c in enumerate(k.distortion)]  # p2 bends along x
    back = PinholeIntrinsics(k.width, k.height, k.fx, k.fy, k.width - 1.0 - k.cx, k.cy, tuple(distortion))
    turned = {v: (ids, board.mirrored(BoardCorners(ids, a), k.width).pixels, b) for v, (ids, a, b) in used.items()}
    return _stereo(turned, back, reference.intrinsics, board)[0] < rms / MIRROR_RATIO
