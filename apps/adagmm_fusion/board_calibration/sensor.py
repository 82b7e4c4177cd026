"""One sensor's intrinsics from the boards it saw, and its depth unit held against them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from adagmm_fusion.board_calibration.boards import MIN_CORNERS, BoardCorners, Charuco, Chessboard
from adagmm_fusion.board_calibration.views import SensorViews
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_o3d.errors import InputError

MIN_VIEWS = 5
# A view is an outlier if its error exceeds both this multiple of the views' median and the second number.
OUTLIER_RATIO, OUTLIER_MIN_PX = 3.0, 0.5
# With more outliers than this, it is not clear which views are the wrong ones.
MAX_OUTLIER_SHARE = 1.0 / 3.0
# A corner of a partly hidden board is left out if its error exceeds both this multiple of the median and the second.
CORNER_RATIO, CORNER_MIN_PX = 5.0, 0.3
# If the normals of all boards lie within this angle, they do not determine the focal length, however well they fit.
MIN_TILT_DEG = 15.0
# Focal lengths less certain than this come from boards that all faced the sensor alike, or from too few.
MAX_FOCAL_UNCERTAINTY = 0.01
DISTORTION_FLAGS = {
    0: cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    4: cv2.CALIB_FIX_K3,
    5: 0,
    8: cv2.CALIB_RATIONAL_MODEL,
}


@dataclass(frozen=True, eq=False)
class SensorResult:
    """One calibrated sensor.

    uncertainty_px : standard deviations of fx, fy, cx, cy.
    corners : by view that was used.
    errors_px : by view that was used, root mean square reprojection error.    outliers_px : of the views left out.
    depth_units_per_metre, depth_spread : median and its standard error over views, from the board; None without depth.
    """

    name: str
    intrinsics: PinholeIntrinsics
    uncertainty_px: tuple[float, float, float, float]
    rms_px: float
    corners: dict[str, BoardCorners]
    errors_px: dict[str, float]
    outliers_px: dict[str, float]
    depth_units_per_metre: float | None = None
    depth_spread: float | None = None


def calibrate_sensor(
    views: SensorViews, board: Chessboard | Charuco, coefficients: int, folder: str | Path
) -> SensorResult:
    """Intrinsics with `coefficients` of distortion (0, 4, 5 or 8); views that do not fit are left out and named.

    Raises
    ------
    RecordingError  naming folder and sensor, if too few views show the board, they do not determine the focal length,
        or too many contradict the others.
    """
    if coefficients not in DISTORTION_FLAGS:
        known = ", ".join(map(str, DISTORTION_FLAGS))
        raise InputError(f"distortion: expected one of {known} coefficients, got {coefficients}")
    label = f"{folder}: {views.name}"
    used = dict(views.corners)
    outliers: dict[str, float] = {}
    enough_views(label, views, len(used), board)
    while True:
        fit = _calibrate(views.size, used, board, coefficients)
        errors_px = dict(zip(used, fit.errors_px, strict=True))
        if bad := outlying(errors_px):
            outliers |= {view: errors_px[view] for view in bad}
            used = {view: corners for view, corners in used.items() if view not in bad}
            not_too_many(label, outliers, len(views.corners))
            enough_views(label, views, len(used), board)
        elif board.may_be_hidden and (cleaned := _without_bad_corners(used, fit, board)) is not None:
            used = {view: corners for view, corners in cleaned.items() if len(corners.ids) >= MIN_CORNERS}
            enough_views(label, views, len(used), board)
        else:
            break
    K, uncertainty = fit.K, fit.uncertainty
    certain = uncertainty[0] < MAX_FOCAL_UNCERTAINTY * K[0, 0] and uncertainty[1] < MAX_FOCAL_UNCERTAINTY * K[1, 1]
    if not certain or _tilt_deg(fit.poses) < MIN_TILT_DEG:
        raise RecordingError(
            f"{label}: the {len(used)} views leave the focal length open; "
            "add views with the board tilted by 20 to 45 degrees to all sides, near and far"
        )
    intrinsics = PinholeIntrinsics(*views.size, K[0, 0], K[1, 1], K[0, 2], K[1, 2], tuple(fit.distortion))
    scale, spread = _depth_units(views, used, board, fit.poses)
    return SensorResult(
        views.name, intrinsics, tuple(uncertainty), fit.rms_px, used, errors_px, outliers, scale, spread
    )


def outlying(errors_px: dict[str, float]) -> list[str]:
    """The views whose error stands out."""
    limit = max(OUTLIER_RATIO * float(np.median(list(errors_px.values()))), OUTLIER_MIN_PX)
    return [view for view, error in errors_px.items() if error > limit]


def not_too_many(label: str, outliers: dict[str, float], of: int) -> None:
    """Raises RecordingError if the outliers are more than a third."""
    if len(outliers) > MAX_OUTLIER_SHARE * of:
        worst = sorted(outliers, key=outliers.get, reverse=True)
        raise RecordingError(
            f"{label}: {len(outliers)} of {of} views contradict the others ({', '.join(worst[:5])}); check that the "
            "board is flat and stood still, and take them again"
        )


def enough_views(label: str, views: SensorViews, used: int, board: Chessboard | Charuco) -> None:
    """Raises RecordingError if fewer than MIN_VIEWS are."""
    if used >= MIN_VIEWS:
        return
    hint = "check the board's size, its lighting, and that it is large enough in the image"
    if not board.may_be_hidden:
        hint += "; a chessboard must be in sight as a whole, a ChArUco board need not"
    without = ", ".join(views.without_board[:5])
    seen = f"found in {len(views.corners)} of {len(views.corners) + len(views.without_board)} images"
    raise RecordingError(
        f"{label}: expected at least {MIN_VIEWS} good views of the board, got {used}, {seen}"
        + (f" (not in {without})" if without else "")
        + f"; {hint}"
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    rms_px: float
    K: np.ndarray
    distortion: np.ndarray
    poses: list[tuple[np.ndarray, np.ndarray]]  # rotation vector and translation of the board, of each view
    uncertainty: np.ndarray
    errors_px: list[float]


def _calibrate(
    size: tuple[int, int], used: dict[str, BoardCorners], board: Chessboard | Charuco, coefficients: int
) -> _Fit:
    objects = [board.points[corners.ids].astype(np.float32) for corners in used.values()]
    pixels = [corners.pixels.astype(np.float32) for corners in used.values()]
    try:
        rms, K, distortion, rotations, translations, deviations, _, errors = cv2.calibrateCameraExtended(
            objects, pixels, size, None, None, flags=DISTORTION_FLAGS[coefficients]
        )
    except cv2.error as problem:
        raise RecordingError(f"the calibration failed: {problem.err}; take more views") from problem
    poses = list(zip(rotations, translations, strict=True))
    return _Fit(rms, K, distortion.ravel()[:coefficients], poses, deviations.ravel()[:4], errors.ravel().tolist())


def _without_bad_corners(
    used: dict[str, BoardCorners], fit: _Fit, board: Chessboard | Charuco
) -> dict[str, BoardCorners] | None:
    """The views without corners that stand out, which something half hides; None if there is none."""
    residuals = {}
    for (view, corners), pose in zip(used.items(), fit.poses, strict=True):
        seen, _ = cv2.projectPoints(board.points[corners.ids], *pose, fit.K, fit.distortion)
        residuals[view] = np.linalg.norm(seen.reshape(-1, 2) - corners.pixels, axis=1)
    limit = max(CORNER_RATIO * float(np.median(np.concatenate(list(residuals.values())))), CORNER_MIN_PX)
    if all((residual <= limit).all() for residual in residuals.values()):
        return None
    good = {view: residual <= limit for view, residual in residuals.items()}
    return {view: BoardCorners(c.ids[good[view]], c.pixels[good[view]]) for view, c in used.items()}


def _tilt_deg(poses: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """The largest angle between the normals of two boards."""
    normals = np.array([cv2.Rodrigues(rotation)[0][:, 2] for rotation, _ in poses])
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0).min())))


def _depth_units(
    views: SensorViews,
    used: dict[str, BoardCorners],
    board: Chessboard | Charuco,
    poses: Sequence[tuple[np.ndarray, np.ndarray]],
) -> tuple[float | None, float | None]:
    """Stored depth over the board's own, median over the views, and how certain that is."""
    scales = []
    for view, (rotation, translation) in zip(used, poses, strict=True):
        if view in views.corner_depths:
            z = (board.points[used[view].ids] @ cv2.Rodrigues(rotation)[0].T + translation.ravel())[:, 2]
            ratios = views.corner_depths[view] / z
            if np.isfinite(ratios).any():
                scales.append(np.nanmedian(ratios))
    if not scales:
        return None, None
    middle = float(np.median(scales))
    return middle, float(1.4826 * np.median(np.abs(np.array(scales) - middle)) / np.sqrt(len(scales)))
