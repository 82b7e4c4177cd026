"""The errors of every stage of a pair as series on a logarithmic axis: identity, start, end, and the limits."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from adagmm_fusion.pairs.stages import END, IDENTITY, START, Stage, worse_than_start
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.colors import BAD_COLOR, GOOD_COLOR, INITIAL_COLOR, LIMIT_COLOR
from adagmm_fusion.rerun_log.iterations import LEAST_SHOWN
from adagmm_fusion.rerun_log.verdict import Limits
from adagmm_fusion.rerun_log.when import When

WRONG_END, LIMIT = "end_wrong", "limit"
# What marks each stage, and its size in the viewer's points.
MARKERS = {
    IDENTITY: (rr.components.MarkerShape.Cross, (140, 140, 140), 4.0),
    START: (rr.components.MarkerShape.Diamond, INITIAL_COLOR, 5.0),
    END: (rr.components.MarkerShape.Circle, GOOD_COLOR, 5.0),
    # failed, or worse than its start
    WRONG_END: (rr.components.MarkerShape.Square, BAD_COLOR, 6.0),
}
METRICS = (entities.ROTATION_ERROR_DEG, entities.TRANSLATION_ERROR_MM)


def log_stage_styles(rec: rr.RecordingStream) -> None:
    """Names, markers and colours of the series, once per recording."""
    for metric in METRICS:
        for name, (marker, color, size) in MARKERS.items():
            style = rr.SeriesPoints(names=name.replace("_", ", "), markers=marker, colors=color, marker_sizes=size)
            rec.log(_entity(metric, name), style, static=True)
        style = rr.SeriesLines(names=LIMIT, colors=LIMIT_COLOR, widths=1.0)
        rec.log(_entity(metric, LIMIT), style, static=True)


def log_stages(
    rec: rr.RecordingStream, stages: Sequence[Stage], limits: Limits, *, failed: bool, iterations: int, when: When
) -> None:
    """Log the errors of a pair's stages where the ground truth is known; nothing where it is not.

    Identity and start stand at iteration 0, the end at the last of `iterations`. An end that is worse than its start is
    red, like a failed one.
    """
    at = {END: iterations}
    by_name = {stage.stage: stage for stage in stages}
    if END not in by_name or by_name[END].rotation_error_deg is None:
        return
    end = WRONG_END if failed or worse_than_start(by_name[START], by_name[END]) else END
    for name, stage in by_name.items():
        for metric, value in zip(METRICS, (stage.rotation_error_deg, stage.translation_error_mm), strict=True):
            _log(rec, _entity(metric, end if name == END else name), value, at.get(name, 0), when)
    for metric, value in zip(METRICS, (limits.rotation_deg, limits.translation_mm), strict=True):
        for iteration in (0, iterations):
            _log(rec, _entity(metric, LIMIT), value, iteration, when)


def _entity(metric: str, name: str) -> str:
    return f"{entities.stages_of(metric)}/{name}"


def _log(rec: rr.RecordingStream, entity: str, value: float, iteration: int, when: When) -> None:
    when.log_event(rec, entity, iteration, rr.Scalars(float(np.log10(max(value, LEAST_SHOWN)))))
