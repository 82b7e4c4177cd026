"""One registered pair, everything about it."""

import numpy as np
import open3d as o3d
import rerun as rr

from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.meshes.textured_mesh import TexturedMesh
from adagmm_fusion.pairs.feature_start import FeatureStart
from adagmm_fusion.pairs.partners import partner_distance as default_partner_distance
from adagmm_fusion.pairs.point_diagnostics import PointDiagnostics, diagnose
from adagmm_fusion.pairs.spread import point_variance
from adagmm_fusion.pairs.stages import Stage, stages_of, worse_than_start
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.cameras import FRUSTUM_DEPTH, log_blank_images, log_frustum, log_images, log_pose
from adagmm_fusion.rerun_log.clouds import DIMMED, log_points, own_colors, shaded_colors, variance_mm2
from adagmm_fusion.rerun_log.colors import (
    DIMMED_TARGET_COLOR,
    INITIAL_COLOR,
    SOURCE_COLOR,
    TARGET_CAMERA_COLOR,
    TARGET_COLOR,
    TRUTH_COLOR,
)
from adagmm_fusion.rerun_log.differences import log_difference, log_unobservable
from adagmm_fusion.rerun_log.ellipsoids import log_covariances
from adagmm_fusion.rerun_log.entities import INITIAL_SOURCE, RECORDED_SOURCE, SOURCE, TARGET, TRUE_SOURCE
from adagmm_fusion.rerun_log.eyes import NARROW, log_eye
from adagmm_fusion.rerun_log.guide import log_guide
from adagmm_fusion.rerun_log.iterations import log_curve_styles, log_estimate_iterations
from adagmm_fusion.rerun_log.legends import log_legends, log_residual_histogram, why_layers
from adagmm_fusion.rerun_log.matches import log_matches
from adagmm_fusion.rerun_log.meshes import log_shape_mesh, log_textured_mesh, surface_of
from adagmm_fusion.rerun_log.messages import log_messages
from adagmm_fusion.rerun_log.overlay import log_overlay
from adagmm_fusion.rerun_log.stages import log_stage_styles, log_stages
from adagmm_fusion.rerun_log.verdict import DEFAULT_LIMITS, Limits, pair_report
from adagmm_fusion.rerun_log.when import When
from adagmm_fusion.rerun_log.words import markdown
from adagmm_o3d.result import PointRegistrationResult

# A camera is drawn this large about its place.
FRUSTUM_CORNERS = FRUSTUM_DEPTH * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def log_pair(
    rec: rr.RecordingStream,
    pair: RGBDPair,
    source_cloud: o3d.geometry.PointCloud,
    target_cloud: o3d.geometry.PointCloud,
    estimate: PointRegistrationResult | None,
    *,
    frame_index: int | None = None,
    em_step: int = 0,
    status: str = "",
    reason: str = "",
    seconds: float | None = None,
    report: str | None = None,
    limits: Limits = DEFAULT_LIMITS,
    partner_distance: float | None = None,
    fused: TexturedMesh | None = None,
    features: FeatureStart | None = None,
    diagnosis: str = "",
) -> int:
    """Log one pair: both sensors with images, clouds and surfaces, every EM iteration, the result and why it is so.

    Parameters
    ----------
    rec : where to log; nothing global is used.
    pair : the frames, and the truth `T_target_source` where it is known.
    source_cloud, target_cloud : what was registered: points [m] in each sensor's own frame, colors, normals and
        covariances where they have them.
    estimate : a `PointRegistrationResult`, or None if the registration refused the pair.
    frame_index : the pair's number in a recording of many, on the timeline `frame`; None for a recording of this pair.
    em_step : with frame_index, where this pair starts on the timeline `em_step`.
    status, reason : "failed" and why, if the caller says so; otherwise the verdict follows from `limits`.
    seconds : what the registration took.
    report : markdown for the report view instead of the standard one.
    partner_distance : how near [m] a target point counts as a partner; None for what registrations are judged by.
    features : where the registration was told to start, if the colour images agreed on that.
    diagnosis : one sentence on why the pair came out so.
    fused : both frames as one textured surface at the estimate, in the target's frame, as `textured_moment` makes it.

    Returns
    -------
    The `em_step` at which the next pair starts.
    """
    when = When(frame_index, em_step, pair.source.timestamp)
    rec.log(entities.WORLD, rr.ViewCoordinates.RDF, static=True)
    log_curve_styles(rec)
    log_stage_styles(rec)
    log_guide(rec)
    T_truth = pair.T_target_source
    stages: tuple[Stage, ...] = ()
    if estimate is not None:
        near = default_partner_distance(target_cloud, partner_distance)
        stages = stages_of(pair, source_cloud, target_cloud, estimate, near, features)
    T_initial = np.array(stages[1].T_target_source) if stages else np.eye(4)
    T_estimate = T_initial if estimate is None else np.asarray(estimate.transformation)

    _log_sensors(rec, pair, T_initial, when)
    log_textured_mesh(rec, entities.FUSED, fused, when)
    rows = 1
    if estimate is None:
        log_pose(rec, SOURCE, T_initial, when)
    else:
        rows = log_estimate_iterations(rec, estimate, T_truth, when, variance=point_variance(source_cloud))
        log_stages(rec, stages, limits, failed=status == "failed", iterations=rows - 1, when=when)
    diagnostics = None
    if estimate is not None:
        diagnostics = diagnose(
            source_cloud, target_cloud, estimate, target_frame=pair.target, partner_distance=partner_distance
        )
    _log_clouds(rec, source_cloud, target_cloud, estimate, diagnostics, when)
    worse = bool(stages) and worse_than_start(stages[1], stages[2])
    log_difference(rec, T_estimate, T_truth, when, bad=worse or status == "failed")
    _log_eyes(rec, pair, np.asarray(source_cloud.points), np.asarray(target_cloud.points), T_initial, T_estimate, when)
    log_matches(rec, pair, features, T_estimate, when)
    moved = np.asarray(source_cloud.points) @ T_estimate[:3, :3].T + T_estimate[:3, 3]
    unobservable = () if estimate is None else estimate.unobservable
    log_unobservable(rec, unobservable, moved, np.asarray(target_cloud.points), when)
    log_overlay(rec, pair.source, pair.target, T_estimate, when)
    if report is None:
        report = pair_report(
            pair.name,
            estimate,
            stages,
            diagnostics,
            limits,
            variance=point_variance(source_cloud),
            status=status,
            reason=reason,
            diagnosis=diagnosis,
            seconds=seconds,
        )
    when.log(rec, entities.REPORT, markdown(report))
    log_messages(rec, pair.name, estimate, reason, when)
    return em_step + rows


def log_refused_pair(
    rec: rr.RecordingStream,
    name: str,
    reason: str,
    *,
    before: RGBDPair | None = None,
    frame_index: int | None = None,
    em_step: int = 0,
) -> int:
    """Log a pair of which there are no clouds: its report says why, and nothing of the pair `before` is left to see.

    Returns the `em_step` at which the next pair starts.
    """
    when = When(frame_index, em_step)
    when.clear(rec, entities.WORLD)
    for eye in (entities.EYE, entities.EYE_WITH_SENSORS, entities.EYE_AT_END):  # where there is none, a view shows axes
        log_eye(rec, eye, [FRUSTUM_CORNERS], when)
    if before is not None:
        target, source = before.target.intrinsics, before.source.intrinsics
        log_blank_images(rec, (target.width, target.height), (source.width, source.height), when)
    when.clear(rec, entities.DIAGNOSTICS)
    when.clear(rec, entities.MATCHES)
    log_guide(rec)
    report = pair_report(name, None, (), status="failed", reason=reason)
    when.log(rec, entities.REPORT, markdown(report))
    log_messages(rec, name, None, reason, when)
    return em_step + 1


def _log_eyes(
    rec: rr.RecordingStream,
    pair: RGBDPair,
    source: np.ndarray,
    target: np.ndarray,
    T_initial: np.ndarray,
    T_estimate: np.ndarray,
    when: When,
) -> None:
    """Eyes that see the target, and the source at every stage; one of them the sensors as well, one only the end."""
    clouds = [target, source, *(source @ T[:3, :3].T + T[:3, 3] for T in (T_initial, T_estimate))]
    log_eye(rec, entities.EYE, clouds, when)
    log_eye(rec, entities.EYE_AT_END, [target, clouds[-1]], when, aspect=NARROW)
    poses = [np.eye(4), T_initial, T_estimate, *([] if pair.T_target_source is None else [pair.T_target_source])]
    log_eye(
        rec,
        entities.EYE_WITH_SENSORS,
        [*clouds, np.array([T[:3, 3] + d for T in poses for d in FRUSTUM_CORNERS])],
        when,
    )


def _log_sensors(rec: rr.RecordingStream, pair: RGBDPair, T_initial: np.ndarray, when: When) -> None:
    log_pose(rec, TARGET, np.eye(4), when)
    log_pose(rec, RECORDED_SOURCE, np.eye(4), when)
    log_pose(rec, INITIAL_SOURCE, T_initial, when)
    log_frustum(rec, INITIAL_SOURCE, pair.source.intrinsics, INITIAL_COLOR, when)
    log_frustum(rec, TARGET, pair.target.intrinsics, TARGET_CAMERA_COLOR, when)
    log_frustum(rec, SOURCE, pair.source.intrinsics, SOURCE_COLOR, when)
    for sensor, frame, color in ((TARGET, pair.target, TARGET_COLOR), (SOURCE, pair.source, SOURCE_COLOR)):
        log_images(rec, sensor, frame, when)
        surface = surface_of(frame)
        log_shape_mesh(rec, sensor.shape, surface, color, when)
    log_shape_mesh(rec, INITIAL_SOURCE.shape, surface, SOURCE_COLOR, when)
    log_shape_mesh(rec, RECORDED_SOURCE.shape, surface, SOURCE_COLOR, when)
    if pair.T_target_source is None:
        when.clear(rec, TRUE_SOURCE.root)
    else:
        log_pose(rec, TRUE_SOURCE, pair.T_target_source, when)
        log_frustum(rec, TRUE_SOURCE, pair.source.intrinsics, TRUTH_COLOR, when)


def _log_clouds(
    rec: rr.RecordingStream,
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    estimate: PointRegistrationResult | None,
    diagnostics: PointDiagnostics | None,
    when: When,
) -> None:
    dimmed = {DIMMED: shaded_colors(target, DIMMED_TARGET_COLOR)}
    sigma = estimate.sigma if estimate is not None else 0.0
    values = _variances(target, sigma)
    log_points(rec, TARGET.points, np.asarray(target.points), own_colors(target), when, dimmed, values)
    why = why_layers(diagnostics, len(source.points))
    values = _variances(source, sigma)
    if diagnostics is not None:
        values |= {
            "weight_share": diagnostics.weight_share,
            "residual_mm": diagnostics.residual_mm,
            "partner_in_target": diagnostics.partner,
        }
        if diagnostics.color_support is not None:
            values["color_support_nats"] = diagnostics.color_support
    log_points(rec, SOURCE.points, np.asarray(source.points), own_colors(source), when, why, values)
    if diagnostics is not None:
        log_legends(rec, diagnostics, when)
        log_residual_histogram(rec, diagnostics, when)
    for sensor, cloud, color in ((TARGET, target, TARGET_COLOR), (SOURCE, source, SOURCE_COLOR)):
        if estimate is not None and len(estimate.sigmas) and cloud.has_covariances():
            log_covariances(rec, sensor.covariances, cloud, estimate.sigmas, color, when)
        else:
            when.clear(rec, sensor.covariances)


def _variances(cloud: o3d.geometry.PointCloud, sigma: float) -> dict[str, np.ndarray]:
    variances = variance_mm2(cloud, sigma)
    return {} if variances is None else {"variance_mm2": variances}
