"""What a run found: one record per pair, as a table in the terminal, as report.md and as report.json."""

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from importlib import metadata
from pathlib import Path

import numpy as np
from rich.table import Table
from rich.text import Text

from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.pairs.record import PairRecord
from adagmm_fusion.pairs.settings import Settings

SCHEMA, VERSION = "adagmm-fusion-report", 1
PACKAGES = ("adagmm-o3d", "open3d", "numpy", "numba", "rerun-sdk")

MEDIANS = (
    "rotation_error_frobenius",
    "rotation_error_deg",
    "translation_error_mm",
    "overlap",
    "seconds_registration",
)
COLUMNS = (
    "pair",
    "‖I − R_gt R⁻¹‖",
    "rotation [°]",
    "translation [mm]",
    "overlap",
    "true overlap",
    "σ",
    "iterations",
    "time [s]",
    "verdict",
)
NOTES = (
    "Errors are against the ground truth of the recording or its rig. Overlap is the share of source points with a "
    "target point nearer than the partner distance, at the estimate and at the ground truth; where the first is not "
    "smaller, the estimate explains the clouds as well as the ground truth does. σ scales the covariances at the end. "
    "Time is that of the registration alone, on clouds that are there."
)


@dataclass(frozen=True)
class Report:
    """A run over a recording.

    pairs_asked : how many pairs the run was to register; records are fewer if it was interrupted.
    notes : what reading the recording left out, and what looks wrong in it, a line each.
    results : other files of the run by what they are, relative to the report.
    """

    recording: str
    path: str
    format: str
    sensors: tuple[str, ...]
    calibration: str | None
    settings: Settings
    pairs_asked: int
    records: Sequence[PairRecord]
    interrupted: bool = False
    notes: Sequence[str] = ()
    results: dict[str, str] = field(default_factory=dict)

    @property
    def ok(self) -> int:
        return sum(record.status == "ok" for record in self.records)

    def median(self, name: str) -> float | None:
        """The median of a number over all records that have it, failed ones included."""
        values = [value for record in self.records if (value := getattr(record, name)) is not None]
        return float(np.median(values)) if values else None

    def headline(self) -> str:
        """The result in one sentence."""
        parts = [f"{self.ok} of {len(self.records)} pairs registered"]
        if (rotation_deg := self.median("rotation_error_deg")) is not None:
            parts.append(f"median error {rotation_deg:.2f}° and {self.median('translation_error_mm'):.0f} mm")
        if self.interrupted:
            parts.append(f"interrupted, {self.pairs_asked - len(self.records)} of {self.pairs_asked} not tried")
        return "; ".join(parts)

    def failures(self) -> list[str]:
        """One line for each failed pair."""
        return [f"{record.pair}: {record.reason}" for record in self.records if record.status != "ok"]


def terminal_table(report: Report) -> Table:
    """The table of all pairs, for rich."""
    # Text, not str: rich would take a unit in brackets for markup.
    table = Table(title=Text(f"{report.recording}: {report.headline()}"), title_justify="left")
    for index, name in enumerate(COLUMNS):
        table.add_column(Text(name), justify="left" if index in (0, len(COLUMNS) - 1) else "right", overflow="fold")
    for record in report.records:
        table.add_row(*map(Text, _row(record)), style=None if record.status == "ok" else "red")
    return table


def markdown(report: Report) -> str:
    """report.md."""
    lines = [f"# {report.recording}", "", f"**{report.headline()}.**", ""]
    lines += ["| " + " | ".join(COLUMNS) + " |", "|:--" + "|--:" * (len(COLUMNS) - 2) + "|:--|"]
    lines += ["| " + " | ".join(cell.replace("|", "/") for cell in _row(record)) + " |" for record in report.records]
    lines += ["", NOTES]
    if report.notes:
        lines += ["", "## Notes on the recording", "", *(f"- {note}" for note in report.notes)]
    if failures := report.failures():
        lines += ["", "## Failures", "", *(f"- {line}" for line in failures)]
    warned = [(record, text) for record in report.records for text in record.warnings]
    if warned:
        lines += ["", "## Warnings of the estimates", "", *(f"- {record.pair}: {text}" for record, text in warned)]
    lines += ["", "## Results", "", *(f"- {what}: [{path}]({path})" for what, path in report.results.items())]
    lines += ["", "## Run", "", f"- recording: {report.path} ({report.format}; sensors {', '.join(report.sensors)})"]
    lines += [f"- calibration: {report.calibration or 'as in the recording'}"]
    lines += [f"- {name}: {'automatic' if value is None else value}" for name, value in asdict(report.settings).items()]
    lines += ["- " + ", ".join(f"{name} {version}" for name, version in versions().items())]
    return "\n".join(lines) + "\n"


def as_json(report: Report) -> str:
    """report.json: what report.md has, and the poses."""
    content = {
        "schema": SCHEMA,
        "version": VERSION,
        "recording": {
            "name": report.recording,
            "path": report.path,
            "format": report.format,
            "sensors": list(report.sensors),
            "calibration": report.calibration,
            "notes": list(report.notes),
        },
        "interrupted": report.interrupted,
        "summary": {
            "pairs_asked": report.pairs_asked,
            "pairs_done": len(report.records),
            "ok": report.ok,
            "failed": len(report.records) - report.ok,
            "median": {name: report.median(name) for name in MEDIANS},
        },
        "settings": asdict(report.settings),
        "versions": versions(),
        "results": report.results,
        "pairs": [asdict(record) for record in report.records],
    }
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_report(folder: Path, report: Report) -> tuple[Path, Path]:
    """Write report.md and report.json into a folder; returns their paths. Raises OutputError if that is impossible."""
    paths = folder / "report.md", folder / "report.json"
    write_text(paths[0], markdown(report))
    write_text(paths[1], as_json(report))
    return paths


def versions() -> dict[str, str]:
    """Python's, and those of the packages a result may depend on."""
    return {"python": platform.python_version()} | {name: metadata.version(name) for name in PACKAGES}


def _row(record: PairRecord) -> list[str]:
    verdict = record.status if record.judged_by != "estimate" else f"{record.status} (no ground truth)"
    return [
        record.pair,
        _cell(record.rotation_error_frobenius, ".4f"),
        _cell(record.rotation_error_deg, ".2f"),
        _cell(record.translation_error_mm, ".1f"),
        _cell(record.overlap, ".3f"),
        _cell(record.overlap_truth, ".3f"),
        _cell(record.sigma, ".2e"),
        _cell(record.iterations, "d"),
        _cell(record.seconds_registration, ".2f"),
        verdict,
    ]


def _cell(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
