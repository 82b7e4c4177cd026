"""One trial for the Rerun viewer: both clouds, where the source was, comes to lie, and belongs; flagged points grey."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from adagmm_bench.problem import Cloud, Problem

TARGET_COLOR, SOURCE_COLOR, FLAGGED_COLOR = (70, 130, 255), (255, 140, 0), (130, 130, 130)
RADIUS_SHARE = {2: 0.018, 3: 0.009}  # of the target's RMS radius; fewer points in 2D
STEP = "iteration"


def replay_blueprint(dimension: int) -> rrb.Blueprint:
    """Before, after and truth beside each other, the record of the trial below."""
    view = rrb.Spatial2DView if dimension == 2 else rrb.Spatial3DView
    scenes = [
        view(origin="/", name=name, contents=["/target", f"/{entity}"])
        for name, entity in (("Before", "before"), ("Estimate", "estimate"), ("Truth", "truth"))
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(*scenes),
            rrb.Horizontal(
                rrb.TextDocumentView(origin="/record", name="Record"),
                rrb.TimeSeriesView(origin="/rotation_error_deg", name="Rotation error [°]"),
            ),
            row_shares=[2, 1],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=STEP),
        auto_views=False,
    )


def log_replay(rec: rr.RecordingStream, problem: Problem, poses: np.ndarray, errors_deg: np.ndarray, text: str) -> None:
    """Log a trial.

    Parameters
    ----------
    poses : (K, D+1, D+1) of the source in the units of the problem's clouds, the last one is the estimate.
    errors_deg : (K,) rotation errors of the poses [deg].     text : the trial's record, markdown.
    """
    radius = RADIUS_SHARE[problem.dimension] * problem.target.rms_radius()
    _log_cloud(rec, "target", problem.target, np.eye(problem.dimension + 1), TARGET_COLOR, radius)
    _log_cloud(rec, "before", problem.source, np.eye(problem.dimension + 1), SOURCE_COLOR, radius)
    if problem.T_target_source is not None:
        _log_cloud(rec, "truth", problem.source, problem.T_target_source, SOURCE_COLOR, radius)
    rec.log("record", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
    for step, (T, error_deg) in enumerate(zip(poses, errors_deg, strict=True)):
        rec.set_time(STEP, sequence=step)
        _log_cloud(rec, "estimate", problem.source, T, SOURCE_COLOR, radius, static=False)
        rec.log("rotation_error_deg", rr.Scalars(error_deg))


def _log_cloud(
    rec: rr.RecordingStream,
    entity: str,
    cloud: Cloud,
    T: np.ndarray,
    color: tuple[int, int, int],
    radius: float,
    *,
    static: bool = True,
) -> None:
    D = cloud.points.shape[1]
    points = (cloud.points @ T[:D, :D].T + T[:D, D]).astype(np.float32)
    colors = np.where(cloud.flagged()[:, None], np.asarray(FLAGGED_COLOR, np.uint8), np.asarray(color, np.uint8))
    archetype = rr.Points2D if D == 2 else rr.Points3D
    rec.log(entity, archetype(points, colors=colors, radii=radius), static=static)
