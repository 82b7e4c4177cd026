"""The first page of a recording of many pairs: every pair with its figures, the worst first, and why each is so."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from adagmm_fusion.files.markdown import plain
from adagmm_fusion.pairs.record import PairRecord
from adagmm_fusion.pairs.stages import END, IDENTITY, START
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.words import markdown

MARKS = {"ok": "✔", "failed": "×"}
WORSE = "▲"  # the viewer has no coloured signs
FIGURES = ("frame", "", "end °", "mm", "start °", "mm", "identity °", "mm")
HEADINGS = (*FIGURES, "start by", "overlap", "contra", "colour", "⚠", "s")
LEGEND = (
    f"*end*, *start*, *identity*: errors against the ground truth, {WORSE} where the end is worse than the start. "
    "*start by*: how many features agreed, or the clouds alone. *overlap*, *contra*: share of the source with a "
    "partner, and in front of what the target sees [%]. *colour*: correlation of brightness. *⚠*: warnings. In the "
    "plots the identity is a grey ×, the start a blue ◆, the end a green ●, or a red ■ where it failed or is worse "
    "than the start; the line is the limit."
)
HINT = "The timeline `frame` below changes the pair; `em_step` runs through the EM iterations of all pairs."


@dataclass(frozen=True)
class Progress:
    """How far a run is that still goes on.

    pairs : how many it is asked for.    seconds_left : as it looks now.
    """

    pairs: int
    seconds_left: float


def log_recording_summary(
    rec: rr.RecordingStream,
    records: Sequence[PairRecord],
    *,
    title: str = "Summary",
    progress: Progress | None = None,
) -> None:
    """Log the table of all pairs so far, in place of the one before."""
    text = summary_markdown(records, title, progress)
    rec.log(entities.SUMMARY_TABLE, markdown(text), static=True)


def summary_markdown(records: Sequence[PairRecord], title: str, progress: Progress | None = None) -> str:
    """The table, the worst first: pairs without a pose, failed ones, then by rotation error; below it the reasons."""
    if progress is not None and not records:
        return f"### {title}: {progress.pairs} pairs to register\n\nEach is listed here when it is done."
    failed = sum(record.status == "failed" for record in records)
    worse = sum(record.worse_than_start for record in records)
    lines = [f"### {title}: {len(records) - failed} of {len(records)} pairs registered", ""]
    if progress is not None:
        lines += [f"**{len(records)} of {progress.pairs} done, about {_duration(progress.seconds_left)} left.**", ""]
    known = [record for record in records if record.rotation_error_deg is not None]
    if known:
        rotation = np.median([record.rotation_error_deg for record in known])
        translation = np.median([record.translation_error_mm for record in known])
        lines += [f"Median errors: **{rotation:.2f}°**, **{translation:.0f} mm**.", ""]
    if worse:
        lines += [f"{WORSE} {worse} ended worse than {'it' if worse == 1 else 'they'} started.", ""]
    lines += ["| " + " | ".join(HEADINGS) + " |", "|--:|:--" + "|--:" * (len(HEADINGS) - 2) + "|"]
    ordered = sorted(enumerate(records), key=lambda numbered: _badness(numbered[1]), reverse=True)
    lines += [_row(frame, record) for frame, record in ordered]
    lines += ["", LEGEND, "", HINT, ""]
    lines += [_why(frame, record) for frame, record in ordered]
    return "\n".join(lines)


def _row(frame: int, record: PairRecord) -> str:
    cells = [str(frame), MARKS.get(record.status, "") + (WORSE if record.worse_than_start else "")]
    for name in (END, START, IDENTITY):
        stage = record.stage(name)
        cells.append(_cell(None if stage is None else stage.rotation_error_deg, ".2f"))
        cells.append(_cell(None if stage is None else stage.translation_error_mm, ".0f"))
    features = None if record.feature_inliers is None else f"features {record.feature_inliers}"
    cells += [features or record.started_from or "–"]
    for share in (record.overlap, record.contradicted):
        cells.append(_cell(None if share is None else 100.0 * share, ".0f"))
    cells += [_cell(record.color_correlation, ".2f"), str(len(record.warnings) or "–")]
    cells += [_cell(record.seconds_registration, ".2f")]
    return "| " + " | ".join(cells) + " |"


def _why(frame: int, record: PairRecord) -> str:
    words = [text for text in (record.diagnosis, *record.warnings) if text] or [record.reason or record.status]
    return f"- **{frame}** {plain(record.pair)}: {plain('; '.join(words))}."


def _badness(record: PairRecord) -> tuple:
    no_pose = record.status == "failed" and record.rotation_error_deg is None
    off = -1.0 if record.rotation_error_deg is None else record.rotation_error_deg
    return no_pose, record.status == "failed", record.worse_than_start, off


def _cell(value: Any, form: str) -> str:
    return "–" if value is None else format(value, form)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(max(1, round(seconds)), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
