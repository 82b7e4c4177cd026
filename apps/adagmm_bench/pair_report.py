"""Tables and reports over recorded pairs, where translation is in metres and the truth's own overlap is known."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.report import command_line, machine_note, settings_section, summaries_as_json, write_json
from adagmm_bench.summary import Summary
from adagmm_fusion.files.atomic_file import write_text


def pair_table(summaries: Iterable[Summary], records: Sequence[dict]) -> tuple[list[str], list[list]]:
    """A row for each method and start, best mean rotation error first; rotation and mm are means."""
    columns = [
        "method (start)",
        "found",
        "gave up",
        "rotation",
        "median",
        "median°",
        "mm",
        "median mm",
        "overlap",
        "of truth",
        "median s",
        "total s",
    ]
    rows = []
    for s in summaries:
        own = [record for record in records if (record["method"], record["start"]) == (s.method, s.start)]
        rows.append(
            [
                s.label,
                f"{s.found}/{s.trials}",
                s.failed,
                f"{s.mean:.4f}",
                f"{s.median:.4f}",
                f"{s.rotation_deg_median:.2f}",
                f"{1000 * s.translation_mean:.1f}",
                f"{1000 * s.translation_median:.1f}",
                f"{s.overlap_mean:.3f}",
                f"{np.mean([record['overlap_truth'] for record in own]):.3f}",
                f"{s.seconds_median:.3f}",
                f"{s.seconds_total:.2f}",
            ]
        )
    return columns, rows


def write_pair_report(
    folder: Path, title: str, body: str, records: Sequence[dict], summaries: Sequence[Summary], skipped: Sequence[str]
) -> None:
    """report.md and report.json in `folder`."""
    used = dict.fromkeys(s.method for s in summaries if s.method in METHODS)
    head = f"# {title}\n\n`{command_line()}`\n\n{machine_note()}. One thread a registration. "
    write_text(folder / "report.md", head + body + "\n" + settings_section(used, skipped))
    write_json(
        folder / "report.json",
        {
            "command": command_line(),
            "machine": machine_note(),
            "left_out": list(skipped),
            "summaries": summaries_as_json(summaries),
            "trials": list(records),
        },
    )
