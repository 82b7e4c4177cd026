"""One registered pair, everything about it."""

import numpy as np
import open3d as o3d
import rerun as rr

from adagmm_fusion.frames import RGBDPair
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.cameras import log_frustum, log_images, log_pose
from adagmm_fusion.rerun_log.clouds import log_cloud
from adagmm_fusion.rerun_log.colors import INITIAL_COLOR, SOURCE_COLOR, TARGET_CAMERA_COLOR, TRUTH_COLOR
from adagmm_fusion.rerun_log.entities import INITIAL_SOURCE, SOURCE, TARGET, TRUE_SOURCE
from adagmm_fusion.rerun_log.iterations import log_curve_styles, log_estimate_iterations
from adagmm_fusion.rerun_log.verdict import Limits, pair_report
from adagmm_fusion.rerun_log.when import When


def log_pair(
    rec: rr.RecordingStream,
    pair: RGBDPair,
    source_cloud: o3d.geometry.PointCloud,
    target_cloud: o3d.geometry.PointCloud,
    estimate,
    *,
    frame_index: int | None = None,
    em_step: int = 0,
    status: str = "",
    reason: str = "",
    seconds: float | None = None,
    report: str | None = None,
    limits: Limits = Limits(),  # noqa: B008  frozen
    partner_distance: float | None = None,
) -> int:
    """Log one pair: both sensors with images, clouds and textured meshes, every EM iteration, and why it went so.

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
    partner_distance : how near [m] a target point counts as a partner; None for thrice the target's spacing.

    Returns
    -------
    The `em_step` at which the next pair starts.
    """
    when = When(frame_index, em_step)
    rec.log(entities.WORLD, rr.ViewCoordinates.RDF, static=True)
    log_curve_styles(rec)
    T_truth = pair.T_target_source
    T_initial = np.eye(4) if estimate is None else np.asarray(estimate.transformations[0])

    log_pose(rec, TARGET, np.eye(4), when)
    log_pose(rec, INITIAL_SOURCE, T_initial, when)
    for sensor, frame, cloud, color in (
        (TARGET, pair.target, target_cloud, TARGET_CAMERA_COLOR),
        (SOURCE, pair.source, source_cloud, SOURCE_COLOR),
    ):
        log_frustum(rec, sensor, frame.intrinsics, color, when)
        log_images(rec, sensor, frame, when)
        log_cloud(rec, sensor.points, cloud, when)
    log_cloud(rec, INITIAL_SOURCE.points, source_cloud, when)
    log_frustum(rec, INITIAL_SOURCE, pair.source.intrinsics, INITIAL_COLOR, when)
    if T_truth is None:
        when.clear(rec, TRUE_SOURCE.root)
    else:
        log_pose(rec, TRUE_SOURCE, T_truth, when)
        log_frustum(rec, TRUE_SOURCE, pair.source.intrinsics, TRUTH_COLOR, when)

    if estimate is None:
        log_pose(rec, SOURCE, T_initial, when)
        rows = 1
    else:
        rows = log_estimate_iterations(rec, estimate, T_truth, when)
    if report is None:
        report = pair_report(pair.name, estimate, T_truth, limits, status=status, reason=reason, seconds=seconds)
    when.log(rec, entities.REPORT, rr.TextDocument(report, media_type=rr.MediaType.MARKDOWN))
    return em_step + rows
