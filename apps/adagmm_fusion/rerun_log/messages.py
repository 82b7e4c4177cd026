"""The log: what happened to each pair, with the warnings of its estimate."""

import rerun as rr

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.when import When
from adagmm_fusion.rerun_log.words import shown
from adagmm_o3d.result import PointRegistrationResult


def log_messages(
    rec: rr.RecordingStream, pair_name: str, estimate: PointRegistrationResult | None, reason: str, when: When
) -> None:
    """One line for the pair, one for each warning, one for the reason of a failure."""
    lines = []
    if estimate is not None:
        text = f"{pair_name}: {estimate.iterations} EM iterations, stopped: {estimate.stop_reason}"
        lines.append((rr.TextLogLevel.INFO, text))
        lines += [(rr.TextLogLevel.WARN, f"{pair_name}: {warning}") for warning in estimate.warnings]
    if reason:
        lines.append((rr.TextLogLevel.ERROR, f"{pair_name}: {reason}"))
    last = 0 if estimate is None else len(estimate.transformations) - 1
    for level, text in lines:
        when.log_event(rec, entities.LOG, last, rr.TextLog(shown(text), level=level))
