"""`color`: what colours are worth, choice by choice and beside Open3D's coloured ICP, from the same starts."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from adagmm_bench.color_trial import NAMES, STARTS, meaning, run_color_trial, version_of
from adagmm_bench.commands.options import (
    add_trials,
    open_journal,
    placement,
    usable_frame_pairs,
    words,
)
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table, write_json
from adagmm_bench.runner import run_jobs
from adagmm_bench.trial import TrialJob
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.errors import InputError

WORSE = ["start, pair", "without: error [mm]", "with", "its standard deviation"]
# What is measured of an end, and the unit in its name.
ERRORS = {"rotation": "_deg", "translation": ""}
COLUMNS = ["start, method", "found", "median of all: rotation [°]", "translation [mm]", "CPU s, median"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--methods", type=words, default=NAMES, help="names with commas (default: all)")
    add_trials(parser, "color")


def run(arguments: argparse.Namespace) -> int:
    pairs, _ = usable_frame_pairs(arguments)
    names = arguments.methods
    if unknown := [name for name in names if name not in NAMES]:
        raise InputError(f"methods: unknown {', '.join(unknown)}; known are {', '.join(NAMES)}")
    jobs = [TrialJob(pair, name, start) for pair in pairs for start in STARTS for name in names]
    with open_journal(arguments) as journal:
        records = run_jobs(jobs, journal, placement(arguments), run=run_color_trial, version_of=version_of)
    groups = dict.fromkeys(record["problem"]["recording"] for record in records)
    tables = {"all": records} | {name: [r for r in records if r["problem"]["recording"] == name] for name in groups}
    limits = Settings()
    text = (
        f"# What colours are worth\n\n`{command_line()}`\n\n{machine_note()}. The truth, turned about the target's "
        f"centroid and shifted as said, is the start. Found: within {limits.max_rotation_error_deg:g}° and "
        f"{limits.max_translation_error_mm:g} mm.\n\n"
    )
    for title, own in tables.items():
        rows = color_rows(own, names)
        text += f"## {title}\n\n{markdown_table(COLUMNS, rows)}\n"
        print_table(title, COLUMNS, rows)
    if {"adagmm", "adagmm-color"} <= set(names):
        rows = worse_rows(records)
        text += f"## Worse with colours than without, by more than their own standard deviation: {len(rows)}\n\n"
        text += f"{markdown_table(WORSE, rows)}\n" if rows else ""
        print_table("worse with colours, by more than their own standard deviation", WORSE, rows)
    text += "## Methods\n\n" + "".join(f"- `{name}`: {meaning(name)}\n" for name in names)
    write_text(arguments.output / "report.md", text)
    content = {"command": command_line(), "machine": machine_note(), "trials": records}
    write_json(arguments.output / "report.json", content)
    print(printable(f"report and every trial: {arguments.output}"))
    return 0


def worse_rows(records: list[dict]) -> list[list[str]]:
    """A row for each start and pair that ends further from the truth with colours than without, by more than a standard
    deviation that it says of itself, or that says none."""
    ends = {(r["start"], r["problem"]["recording"], r["problem"]["pair"], r["method"]): r for r in records}
    rows = []
    for (start, recording, pair, method), plain in ends.items():
        coloured = ends.get((start, recording, pair, "adagmm-color"))
        if method != "adagmm" or coloured is None:
            continue
        more = {name: coloured[f"{name}_error{unit}"] - plain[f"{name}_error{unit}"] for name, unit in ERRORS.items()}
        own = {name: coloured.get(f"{name}_deviation{unit}", 0.0) for name, unit in ERRORS.items()}
        if any(more[name] > own[name] for name in ERRORS):
            rows.append(
                [
                    f"{start}, {recording}, {pair}",
                    *(
                        f"{r['rotation_error_deg']:.2f}°, {1000 * r['translation_error']:.1f}"
                        for r in (plain, coloured)
                    ),
                    f"{own['rotation']:.2f}°, {1000 * own['translation']:.1f}",
                ]
            )
    return rows


def color_rows(records: list[dict], names: Sequence[str]) -> list[list[str]]:
    """A row for each start and method."""
    limits, rows = Settings(), []
    for start in STARTS:
        for name in names:
            own = [record for record in records if (record["start"], record["method"]) == (start, name)]
            degrees = np.array([record["rotation_error_deg"] for record in own])
            millimetres = 1000.0 * np.array([record["translation_error"] for record in own])
            found = (degrees <= limits.max_rotation_error_deg) & (millimetres <= limits.max_translation_error_mm)
            seconds = np.median([record["cpu_seconds"] for record in own])
            medians = f"{np.median(degrees):.2f}", f"{np.median(millimetres):.1f}", f"{seconds:.2f}"
            rows.append([f"{start}, {name}", f"{found.sum()}/{len(own)}", *medians])
    return rows
