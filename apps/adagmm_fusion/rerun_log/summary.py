"""The first page of a recording of many pairs: every pair with its errors, the worst first, and the errors as bars."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from adagmm_fusion.rerun_log import entities

STATUS_COLORS = {"ok": (60, 190, 110), "failed": (225, 70, 60)}
BAR_WIDTH = 0.8
HINT = "The timeline `frame` below changes the pair; `em_step` runs through the EM iterations of all pairs."


@dataclass(frozen=True)
class SummaryRow:
    """One pair: its number on the timeline `frame`, and how it went.

    status : "ok", or "failed" with the reason.    rotation_deg, translation_mm : None without ground truth.
    overlap : 0 to 1.
    """

    frame_index: int
    name: str
    status: str
    rotation_deg: float | None = None
    translation_mm: float | None = None
    overlap: float | None = None
    iterations: int | None = None
    seconds: float | None = None
    reason: str = ""


def log_recording_summary(rec: rr.RecordingStream, rows: Sequence[SummaryRow], *, title: str = "Summary") -> None:
    """Log the table of all pairs and the two bar charts, once, after the last pair."""
    text = summary_markdown(rows, title)
    rec.log(entities.SUMMARY_TABLE, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
    for entity, field in (
        (entities.SUMMARY_ROTATION_ERROR_DEG, "rotation_deg"),
        (entities.SUMMARY_TRANSLATION_ERROR_MM, "translation_mm"),
    ):
        for status, color in STATUS_COLORS.items():
            known = [
                (r.frame_index, getattr(r, field)) for r in rows if r.status == status and getattr(r, field) is not None
            ]
            if known:
                frames, values = np.array(known, dtype=np.float64).T
                bars = rr.BarChart(
                    values, abscissa=frames - 0.5 * BAR_WIDTH, widths=np.full(len(frames), BAR_WIDTH), color=color
                )
                rec.log(f"{entity}/{status}", bars, static=True)


def summary_markdown(rows: Sequence[SummaryRow], title: str) -> str:
    """The table, the worst first: pairs that gave no pose, then by rotation error, then those without ground truth."""
    failed = sum(row.status == "failed" for row in rows)
    known = [row for row in rows if row.rotation_deg is not None]
    lines = [f"# {title}: {len(rows) - failed} of {len(rows)} pairs registered", ""]
    if known:
        rotation = np.median([row.rotation_deg for row in known])
        translation = np.median([row.translation_mm for row in known])
        lines += [f"Median errors: **{rotation:.2f}°**, **{translation:.0f} mm**.", ""]
    lines += [HINT, ""]
    lines += ["| frame | pair | verdict | rotation [°] | translation [mm] | overlap [%] | iterations | seconds |"]
    lines += ["|--:|:--|:--|--:|--:|--:|--:|--:|"]
    for row in sorted(rows, key=_badness, reverse=True):
        mark = {"failed": "× ", "ok": "✔ "}.get(row.status, "")
        verdict = f"{mark}{row.status}" + (f": {row.reason}" if row.reason else "")
        overlap = None if row.overlap is None else 100.0 * row.overlap
        cells = [
            str(row.frame_index),
            row.name,
            verdict,
            _cell(row.rotation_deg, ".2f"),
            _cell(row.translation_mm, ".0f"),
        ]
        cells += [_cell(overlap, ".0f"), _cell(row.iterations, "d"), _cell(row.seconds, ".2f")]
        lines.append("| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |")
    return "\n".join(lines)


def _badness(row: SummaryRow) -> tuple:
    no_pose = row.status == "failed" and row.rotation_deg is None
    return no_pose, row.status == "failed", row.rotation_deg if row.rotation_deg is not None else -1.0


def _cell(value: Any, form: str) -> str:
    return "–" if value is None else format(value, form)
