"""The EM iterations: the source sensor's pose and the curves, each sent in one call."""

import numpy as np
import rerun as rr

from adagmm_fusion.pairs.spread import spread_mm
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.when import When
from adagmm_o3d.result import PointRegistrationResult

CURVES = {
    entities.ENERGY: ("energy", (90, 160, 255)),
    entities.SIGMA: ("σ [unit²]", (200, 120, 255)),
    entities.SPREAD_MM: ("spread [mm]", (200, 120, 255)),
    entities.ROTATION_ERROR_DEG: ("rotation error [°]", (170, 120, 220)),
    entities.TRANSLATION_ERROR_MM: ("translation error [mm]", (170, 120, 220)),
    entities.FITNESS: ("fitness", (120, 220, 220)),
    entities.INLIER_RMSE: ("inlier RMSE [m]", (230, 110, 140)),
}


LOGARITHMIC = (entities.SPREAD_MM, entities.ROTATION_ERROR_DEG, entities.TRANSLATION_ERROR_MM)
# What is smaller is shown as this: a pose that is exactly right has no logarithm.
LEAST_SHOWN = 1e-3


def log_curve_styles(rec: rr.RecordingStream) -> None:
    """Names and colours of the curves, once per recording."""
    for entity, (name, color) in CURVES.items():
        rec.log(entity, rr.SeriesLines(names=name, colors=color, widths=2.0), static=True)
        if entity in LOGARITHMIC:
            style = rr.SeriesLines(names=f"log₁₀ {name}", colors=color, widths=2.0)
            rec.log(entities.log10_of(entity), style, static=True)


def log_transformations(rec: rr.RecordingStream, entity: str, transformations: np.ndarray, when: When) -> None:
    """Move `entity` through (K+1, 4, 4) poses: before the first EM iteration, and after each."""
    translations = np.ascontiguousarray(transformations[:, :3, 3], dtype=np.float32)
    rotations = np.ascontiguousarray(transformations[:, :3, :3], dtype=np.float32)

    def columns_of(rows):
        return rr.Transform3D.columns(translation=translations[rows], mat3x3=rotations[rows])

    when.send_rows(rec, entity, np.arange(len(transformations)), columns_of)


def log_curve(rec: rr.RecordingStream, entity: str, iterations: np.ndarray, values: np.ndarray, when: When) -> None:
    """Send one curve, and its logarithm if it is shown so; values that are not finite are left out, as a gap says more
    than a spike."""
    values = np.asarray(values, dtype=np.float64)
    finite = np.isfinite(values)
    if not finite.any():
        return
    values, iterations = values[finite], np.asarray(iterations)[finite]
    when.send_rows(rec, entity, iterations, lambda rows: rr.Scalars.columns(scalars=values[rows]))
    if entity in LOGARITHMIC:
        exponents = np.log10(np.maximum(values, LEAST_SHOWN))
        log10 = entities.log10_of(entity)
        when.send_rows(rec, log10, iterations, lambda rows: rr.Scalars.columns(scalars=exponents[rows]))


def log_estimate_iterations(
    rec: rr.RecordingStream,
    estimate: PointRegistrationResult,
    T_truth: np.ndarray | None,
    when: When | None = None,
    *,
    variance: float | None = None,
) -> int:
    """Log every EM iteration of an estimate: pose of the source, spread of the points, energy, and the errors
    where the truth is known.

    Parameters
    ----------
    estimate : with transformations (K+1, 4, 4), sigmas (K,) and energies (K,), as `PointRegistrationResult` has them.
    T_truth : (4, 4) source to target, or None.
    variance : of a point as the clouds' covariances have it, without σ; without it their spread is not logged.
    when : the pair's place on the timelines; left out for a recording of this pair alone.

    Returns
    -------
    The number of rows, K+1: the next pair's `em_step` is this pair's plus that.
    """
    when = When() if when is None else when
    transformations = np.asarray(estimate.transformations, dtype=np.float64)
    log_transformations(rec, entities.SOURCE.root, transformations, when)
    after_each = np.arange(1, len(transformations))
    log_curve(rec, entities.ENERGY, after_each, estimate.energies, when)
    if variance is not None:
        log_curve(rec, entities.SPREAD_MM, after_each, spread_mm(np.asarray(estimate.sigmas), variance), when)
    angles_deg = distances_mm = np.full(len(transformations), np.nan)
    if T_truth is not None:
        angles_deg, distances_mm = pose_errors(transformations, T_truth)
    log_curve(rec, entities.ROTATION_ERROR_DEG, np.arange(len(transformations)), angles_deg, when)
    log_curve(rec, entities.TRANSLATION_ERROR_MM, np.arange(len(transformations)), distances_mm, when)
    return len(transformations)


def pose_errors(transformations: np.ndarray, T_truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle [degrees] and distance [mm] of poses (n, 4, 4) from the true pose (4, 4), each (n,)."""
    relative = transformations[:, :3, :3] @ T_truth[:3, :3].T
    sine = np.linalg.norm(
        np.stack([relative[:, i, j] - relative[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1), axis=1
    )
    angles = np.arctan2(sine, np.trace(relative, axis1=1, axis2=2) - 1.0)
    distances = np.linalg.norm(transformations[:, :3, 3] - T_truth[:3, 3], axis=1)
    return np.rad2deg(angles), distances * 1000.0
