"""The same pictures for a script that calls the plugin: one object, given as `callback_after_iteration`."""

from typing import Any, TypeAlias

import numpy as np
import open3d as o3d
import rerun as rr

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.blueprint import script_dashboard
from adagmm_fusion.rerun_log.cameras import log_pose, transform_archetype
from adagmm_fusion.rerun_log.clouds import DIMMED, SHAPE, log_points, own_colors, shaded_colors
from adagmm_fusion.rerun_log.colors import DIMMED_TARGET_COLOR, SOURCE_COLOR, TARGET_COLOR
from adagmm_fusion.rerun_log.entities import INITIAL_SOURCE, SOURCE, TARGET
from adagmm_fusion.rerun_log.iterations import log_curve_styles, pose_errors
from adagmm_fusion.rerun_log.views import Eye
from adagmm_fusion.rerun_log.when import When

CURVE_OF_KEY = {
    "energy": entities.ENERGY,
    "sigma": entities.SIGMA,
    "fitness": entities.FITNESS,
    "inlier_rmse": entities.INLIER_RMSE,
}

Cloud: TypeAlias = o3d.geometry.PointCloud | o3d.t.geometry.PointCloud


class RegistrationLogger:
    """Logs each iteration of `registration_adaptive_gmm`, or of any function with Open3D's callback, as it happens.

    Parameters
    ----------
    rec : where to log.
    source, target : the clouds, legacy or tensor [m], to be shown before and after; without them only the source's pose
        and the curves are logged, for a recording that has its own scene below the same entities.
    init : (4, 4) where the registration starts, source to target; the identity if left out.
    T_truth : (4, 4) the known answer, for the error curves; or None.
    """

    def __init__(
        self,
        rec: rr.RecordingStream,
        source: Cloud | None = None,
        target: Cloud | None = None,
        *,
        init: np.ndarray | None = None,
        T_truth: np.ndarray | None = None,
    ):
        self._rec = rec
        self._T_truth = None if T_truth is None else np.asarray(T_truth, dtype=np.float64)
        T_initial = np.eye(4) if init is None else np.asarray(init, dtype=np.float64)
        rec.log(entities.WORLD, rr.ViewCoordinates.RDF, static=True)
        log_curve_styles(rec)
        log_pose(rec, INITIAL_SOURCE, T_initial, When())
        if source is not None:
            source = _legacy(source)
            shape = {SHAPE: shaded_colors(source, SOURCE_COLOR)}
            for entity in (SOURCE.points, INITIAL_SOURCE.points):
                log_points(rec, entity, np.asarray(source.points), own_colors(source), When(), shape)
        if target is not None:
            target = _legacy(target)
            shapes = {SHAPE: shaded_colors(target, TARGET_COLOR), DIMMED: shaded_colors(target, DIMMED_TARGET_COLOR)}
            log_points(rec, TARGET.points, np.asarray(target.points), own_colors(target), When(), shapes)
            eye = Eye.around(np.asarray(target.points))
            rec.send_blueprint(script_dashboard(eye=eye, with_truth=T_truth is not None))
        self._log_pose(0, T_initial)

    def __call__(self, values: dict) -> None:
        """Log one iteration from Open3D's dictionary, of numbers and arrays or of tensors."""
        iteration = int(_number(values["iteration_index"])) + 1
        T = values["transformation"]
        self._log_pose(iteration, np.asarray(T.cpu().numpy() if isinstance(T, o3d.core.Tensor) else T))
        for key, entity in CURVE_OF_KEY.items():
            if key in values:
                self._log_scalar(iteration, entity, _number(values[key]))

    def _log_pose(self, iteration: int, T: np.ndarray) -> None:
        When().log_event(self._rec, SOURCE.root, iteration, transform_archetype(T))
        if self._T_truth is not None:
            angles_deg, distances_mm = pose_errors(T[None], self._T_truth)
            self._log_scalar(iteration, entities.ROTATION_ERROR_DEG, angles_deg[0])
            self._log_scalar(iteration, entities.TRANSLATION_ERROR_MM, distances_mm[0])

    def _log_scalar(self, iteration: int, entity: str, value: float) -> None:
        When().log_event(self._rec, entity, iteration, rr.Scalars(value))


def _legacy(cloud: Cloud) -> o3d.geometry.PointCloud:
    return cloud.to_legacy() if isinstance(cloud, o3d.t.geometry.PointCloud) else cloud


def _number(value: Any) -> float:
    return float(value.item() if isinstance(value, o3d.core.Tensor) else value)
