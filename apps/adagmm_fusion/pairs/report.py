"""What a run found: one record per pair, as a table in the terminal, as report.md and as report.json."""

import json
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from rich.box import HEAVY_HEAD, SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.files.markdown import link, plain
from adagmm_fusion.files.stale_results import SCHEMA
from adagmm_fusion.package_versions import package_version
from adagmm_fusion.pairs.record import PairRecord
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.pairs.stages import Stage

VERSION = 1
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
    "deviation",
    "overlap",
    "true overlap",
    "contradicted",
    "spread [mm]",
    "iterations",
    "time [s]",
    "verdict",
)
SHORT_COLUMNS = ("pair", "start", "end", "overlap", "time [s]", "verdict")
STAGES = ("identity", "start", "end")
# The table of all columns takes so much of a terminal; below, the short one is printed.
FULL_WIDTH = 185
RED = "🔴"
NOTES = (
    "Errors are against the ground truth of the recording or its rig. Overlap is the share of source points with a "
    "target point nearer than the partner distance, at the estimate and at the ground truth; where the first is not "
    "smaller, the estimate explains the clouds as well as the ground truth does. Contradicted is the share of source "
    "points in front of what the target's depth image shows. The deviation of rotation and translation is what the "
    "estimate itself says, of cameras whose depth is 1 % and 5 mm off. Spread is the standard deviation of a point at "
    "the end. Time is that of the registration alone, on clouds that are there."
)
STAGE_NOTES = (
    "The identity is the source as recorded; the start is where the registration began, by the features of the colour "
    f"images or by the clouds alone. {RED} marks an end that is worse than its start."
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
        """One line for each failed pair whose diagnosis does not say the reason already."""
        failed = [record for record in self.records if record.status != "ok"]
        return [f"{record.pair}: {record.reason}" for record in failed if record.reason not in record.diagnosis]

    def diagnoses(self) -> list[str]:
        """One line for each pair of which there is a diagnosis: why it came out so."""
        return [f"{record.pair}: {record.diagnosis}" for record in self.records if record.diagnosis]


def terminal_table(report: Report, width: int = FULL_WIDTH) -> Table:
    """The table of all pairs, for rich; in a terminal of fewer columns than all figures take, those that matter."""
    full = width >= FULL_WIDTH
    columns, row = (COLUMNS, _row) if full else (SHORT_COLUMNS, _short_row)
    # Text, not str: rich would take a unit in brackets for markup.
    title = Text(f"{report.recording}: {report.headline()}")
    looks = {"box": HEAVY_HEAD} if full else {"box": SIMPLE_HEAD, "collapse_padding": True, "pad_edge": False}
    table = Table(title=title, title_justify="left", padding=(0, 1), **looks)
    for index, name in enumerate(columns):
        last = index == len(columns) - 1
        table.add_column(
            Text(name), justify="left" if index == 0 or last else "right", overflow="fold", no_wrap=index > 0
        )
    for record in report.records:
        cells = list(map(Text, row(record)))
        if record.worse_than_start:
            for index, name in enumerate(columns):
                if name in ("rotation [°]", "translation [mm]", "end"):
                    cells[index].stylize("red")
        table.add_row(*cells, style=None if record.status == "ok" else "red")
    return table


def markdown(report: Report) -> str:
    """report.md."""
    lines = [f"# {plain(report.recording)}", "", f"**{report.headline()}.**", ""]
    lines += ["| " + " | ".join(COLUMNS) + " |", "|:--" + "|--:" * (len(COLUMNS) - 2) + "|:--|"]
    lines += ["| " + " | ".join(map(plain, _row(record))) + " |" for record in report.records]
    lines += ["", NOTES]
    if any(record.stages for record in report.records):
        lines += ["", "## Stages", "", "| pair | " + " | ".join(STAGES) + " |", "|:--" + "|:--" * len(STAGES) + "|"]
        lines += [_stage_row(record) for record in report.records if record.stages]
        lines += ["", STAGE_NOTES]
    if diagnoses := report.diagnoses():
        lines += ["", "## Why", "", *(f"- {plain(line)}" for line in diagnoses)]
    if report.notes:
        lines += ["", "## Notes on the recording", "", *(f"- {plain(note)}" for note in report.notes)]
    if failures := report.failures():
        lines += ["", "## Failures", "", *(f"- {plain(line)}" for line in failures)]
    warned = [(record, text) for record in report.records for text in record.warnings]
    if warned:
        texts = (f"- {plain(f'{record.pair}: {text}')}" for record, text in warned)
        lines += ["", "## Warnings of the estimates", "", *texts]
    lines += ["", "## Results", "", *(f"- {plain(what)}: {link(path)}" for what, path in report.results.items())]
    recording = f"{report.path} ({report.format}; sensors {', '.join(report.sensors)})"
    lines += ["", "## Run", "", f"- recording: {plain(recording)}"]
    lines += [f"- calibration: {plain(report.calibration or 'as in the recording')}"]
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
    write_text(paths[1], as_json(report))
    write_text(paths[0], markdown(report))
    return paths


def versions() -> dict[str, str]:
    """Python's, and those of the packages a result may depend on."""
    return {"python": platform.python_version()} | {name: package_version(name) for name in PACKAGES}


def _row(record: PairRecord) -> list[str]:
    verdict = record.status if record.judged_by != "estimate" else f"{record.status} (no ground truth)"
    return [
        record.pair,
        _cell(record.rotation_error_frobenius, ".4f"),
        _cell(record.rotation_error_deg, ".2f"),
        _cell(record.translation_error_mm, ".1f"),
        _motion(record.rotation_deviation_deg, record.translation_deviation_mm),
        _cell(record.overlap, ".3f"),
        _cell(record.overlap_truth, ".3f"),
        _cell(record.contradicted, ".3f"),
        _cell(record.spread_mm, ".1f"),
        _cell(record.iterations, "d"),
        _cell(record.seconds_registration, ".2f"),
        verdict,
    ]


def _short_row(record: PairRecord) -> list[str]:
    start, end = (_errors(record.stage(name)) for name in ("start", "end"))
    return [
        record.pair,
        start,
        end,
        _cell(record.overlap, ".2f"),
        _cell(record.seconds_registration, ".2f"),
        record.status,
    ]


def _stage_row(record: PairRecord) -> str:
    cells = [plain(record.pair)]
    for stage in record.stages:
        by = f" ({stage.found_by})" if stage.found_by else ""
        red = f"{RED} " if stage.stage == "end" and record.worse_than_start else ""
        cells.append(f"{red}{_errors(stage)}, overlap {stage.overlap:.2f}{by}")
    return "| " + " | ".join(cells) + " |"


def _errors(stage: Stage | None) -> str:
    return "–" if stage is None else _motion(stage.rotation_error_deg, stage.translation_error_mm)


def _motion(rotation_deg: float | None, translation_mm: float | None) -> str:
    """As in "1.05° 22 mm"."""
    return "–" if rotation_deg is None or translation_mm is None else f"{rotation_deg:.2f}° {translation_mm:.0f} mm"


def _cell(value: float | None, form: str) -> str:
    return "–" if value is None else format(value, form)
