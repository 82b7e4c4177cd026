"""`color`: what colours are worth, choice by choice and beside Open3D's coloured ICP, from the same starts."""

from __future__ import annotations

import argparse

from adagmm_bench.color_table import COLUMNS, color_methods, color_rows, color_text, run_color_trials
from adagmm_bench.color_trial import NAMES
from adagmm_bench.commands.options import (
    add_trials,
    open_journal,
    placement,
    usable_frame_pairs,
    words,
)
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table, write_json
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.errors import InputError

WORSE = ["start, pair", "without: error [mm]", "with", "its standard deviation"]
# What is measured of an end, and the unit in its name.
ERRORS = {"rotation": "_deg", "translation": ""}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--methods", type=words, default=NAMES, help="names with commas (default: all)")
    add_trials(parser, "color")


def run(arguments: argparse.Namespace) -> int:
    pairs, _ = usable_frame_pairs(arguments)
    names = arguments.methods
    if unknown := [name for name in names if name not in NAMES]:
        raise InputError(f"methods: unknown {', '.join(unknown)}; known are {', '.join(NAMES)}")
    with open_journal(arguments) as journal:
        records = run_color_trials(pairs, names, journal, placement(arguments))
    groups = dict.fromkeys(record["problem"]["recording"] for record in records)
    tables = {"all": records} | {name: [r for r in records if r["problem"]["recording"] == name] for name in groups}
    text = f"# What colours are worth\n\n`{command_line()}`\n\n{machine_note()}. {color_text()}\n\n"
    for title, own in tables.items():
        rows = color_rows(own, names)
        text += f"## {title}\n\n{markdown_table(COLUMNS, rows)}\n"
        print_table(title, COLUMNS, rows)
    if {"adagmm", "adagmm-color"} <= set(names):
        rows = worse_rows(records)
        text += f"## Worse with colours than without, by more than their own standard deviation: {len(rows)}\n\n"
        text += f"{markdown_table(WORSE, rows)}\n" if rows else ""
        print_table("worse with colours, by more than their own standard deviation", WORSE, rows)
    text += f"## Methods\n\n{color_methods(names)}"
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
