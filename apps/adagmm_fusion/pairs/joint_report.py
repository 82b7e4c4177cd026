"""The reports of several recordings as one: every recording with its figures, every failed pair with its reason."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.files.markdown import link, plain
from adagmm_fusion.files.stale_results import JOINT_SCHEMA

VERSION = 1


@dataclass(frozen=True)
class RecordingSummary:
    """One recording: the content of its report.json, or why there is none.

    folder : of its results, relative to the joint report.
    """

    name: str
    folder: str
    report: dict[str, Any] | None
    reason: str = ""

    @property
    def failed(self) -> list[dict[str, Any]]:
        """The records of the pairs that failed or ended worse than they started, the worst first."""
        pairs = [] if self.report is None else self.report["pairs"]
        bad = [pair for pair in pairs if pair["status"] != "ok" or pair["worse_than_start"]]
        return sorted(bad, key=lambda pair: (pair["status"] == "ok", -(pair["rotation_error_deg"] or 0.0)))


def joint_markdown(title: str, recordings: Sequence[RecordingSummary]) -> str:
    """report.md of all recordings, those with the most failures first."""
    ordered = sorted(recordings, key=lambda r: (r.report is not None, -len(r.failed)))
    lines = [f"# {plain(title)}", "", "| recording | ok | pairs | median ° | median mm |", "|:--|--:|--:|--:|--:|"]
    lines += [_row(recording) for recording in ordered]
    for recording in ordered:
        if recording.report is None:
            lines += ["", f"## {plain(recording.name)}", "", f"could not be run: {plain(recording.reason)}"]
        elif recording.failed:
            lines += [
                "",
                f"## {plain(recording.name)}",
                "",
                link(f"{recording.folder}/report.md"),
                "",
            ]
            lines += [_why(pair) for pair in recording.failed]
    return "\n".join(lines) + "\n"


def write_joint_report(folder: Path, title: str, recordings: Sequence[RecordingSummary]) -> tuple[Path, Path]:
    """Write report.md and report.json of all recordings into a folder. Raises OutputError if that is impossible."""
    paths = folder / "report.md", folder / "report.json"
    content = {
        "schema": JOINT_SCHEMA,
        "version": VERSION,
        "recordings": [
            {
                "name": recording.name,
                "folder": recording.folder,
                "reason": recording.reason,
                "summary": None if recording.report is None else recording.report["summary"],
                "failed": [
                    {key: pair[key] for key in ("pair", "status", "worse_than_start", "reason", "diagnosis")}
                    for pair in recording.failed
                ],
            }
            for recording in recordings
        ],
    }
    write_text(paths[1], json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    write_text(paths[0], joint_markdown(title, recordings))
    return paths


def _row(recording: RecordingSummary) -> str:
    if recording.report is None:
        return f"| {plain(recording.name)} | – | – | – | – |"
    summary = recording.report["summary"]
    median = summary["median"]
    figures = [_shown(median["rotation_error_deg"], ".2f"), _shown(median["translation_error_mm"], ".0f")]
    return f"| {plain(recording.name)} | {summary['ok']} | {summary['pairs_done']} | {' | '.join(figures)} |"


def _why(pair: dict[str, Any]) -> str:
    mark = "×" if pair["status"] != "ok" else "worse than its start"
    return f"- {mark} {plain(pair['pair'])}: {plain(pair['diagnosis'] or pair['reason'])}"


def _shown(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
