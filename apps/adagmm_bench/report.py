"""Tables in markdown and on the terminal, reports in markdown and JSON, and what the figures were measured on."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from adagmm_bench.methods import METHODS
from adagmm_bench.problem import PREPARATIONS
from adagmm_bench.summary import Summary
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.package_versions import package_version
from adagmm_fusion.processes.terminal import printable


def machine_note() -> str:
    """The processor, the number of cores this process may use, and the versions that matter."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    versions = ", ".join(f"{name} {package_version(name)}" for name in ("open3d", "numpy", "numba"))
    return f"{_processor()}, {cores} cores, {platform.system()}, Python {platform.python_version()}, {versions}"


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def command_line() -> str:
    return " ".join(["adagmm-bench", *sys.argv[1:]])


def markdown_table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; the first column is text, the others are numbers, set to the right."""
    lines = ["| " + " | ".join(columns) + " |", "|---|" + "--:|" * (len(columns) - 1)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """The same table on the terminal."""
    # Text, not str: rich would take a name in brackets for markup.
    table = Table(title=Text(printable(title)), title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(Text(printable(column)), justify="left" if i == 0 else "right", no_wrap=i > 0, overflow="fold")
    for row in rows:
        table.add_row(*(Text(printable(cell)) for cell in row))
    # Without a terminal there is no width to respect, and a log should not lose columns.
    Console(width=None if sys.stdout.isatty() else 160).print(table)


def settings_section(names: Iterable[str], skipped: Sequence[str]) -> str:
    """What the starts are, how every method was set, and which were left out and why."""
    lines = ["## Starts", ""]
    lines += [f"- {name}: {meaning}." for name, meaning in PREPARATIONS.items()]
    lines += ["", "## Methods", "", "Distances are in RMS radii of the larger cloud.", ""]
    for name in names:
        lines.append(f"- `{name}` ({METHODS[name].version()}): {METHODS[name].settings()}")
    if skipped:
        lines += ["", "Left out:", ""] + [f"- {line}" for line in skipped]
    return "\n".join(lines) + "\n"


def write_json(path: Path, content: Mapping) -> None:
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def summaries_as_json(summaries: Iterable[Summary]) -> list[dict]:
    return [summary.as_dict() for summary in summaries]
