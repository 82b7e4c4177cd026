"""`pairs`: clouds as people bring them, from any start, at any overlap: who finds the pose, and who says so."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from adagmm_bench.commands.options import (
    add_data,
    add_output,
    add_placement,
    data_folder,
    open_journal,
    placement,
    words,
)
from adagmm_bench.methods import METHODS
from adagmm_bench.pairs.consensus import judged_by_consensus
from adagmm_bench.pairs.problem import PairSource
from adagmm_bench.pairs.public import CLOUDS, find_public_pairs
from adagmm_bench.pairs.recorded import RECORDINGS, find_recorded_pairs
from adagmm_bench.pairs.tables import ALL, by_group, error_table, found_table
from adagmm_bench.pairs.trial import run_pair_trial
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table, write_json
from adagmm_bench.runner import run_jobs
from adagmm_bench.trial import TrialJob
from adagmm_fusion.files.atomic_file import write_text
from adagmm_o3d.errors import InputError

START = "as-given"
DEFAULT_METHODS = (
    "adagmm",
    "adagmm-global",
    "adagmm-viewpoints",
    "open3d-ransac-gicp",
    "kiss-matcher-gicp",
    "open3d-gicp",
    "small-gicp",
)
CONSENSUS = "clouds, by consensus"


@dataclass(frozen=True)
class Section:
    """Pairs of one kind, and what counts as found among them: `limit` units, of which `scale` make a `unit`."""

    title: str
    found: str
    limit: float
    unit: str
    scale: float
    find: Callable[[Path | None], tuple[Sequence[PairSource], list[str]]]


SECTIONS = {
    RECORDINGS: Section(
        "recorded pairs, geometry alone", "within 5° and 0.2 m", 0.2, "mm", 1000.0, find_recorded_pairs
    ),
    CLOUDS: Section(
        "public pairs of clouds",
        "within 5° and a tenth of the RMS radius, at the source's centroid",
        0.1,
        "% of r",
        100.0,
        lambda folder: (find_public_pairs(folder), []),
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--methods", type=words, help=f"names with commas (default: {','.join(DEFAULT_METHODS)}, those that run here)"
    )
    parser.add_argument(
        "--only", type=words, default=tuple(SECTIONS), help=f"sections with commas (default: {','.join(SECTIONS)})"
    )
    parser.add_argument("--list", action="store_true", help="name the pairs and end")
    add_data(parser)
    add_placement(parser)
    add_output(parser, "pairs")


def run(arguments: argparse.Namespace) -> int:
    if unknown := [name for name in arguments.only if name not in SECTIONS]:
        raise InputError(f"only: unknown {', '.join(unknown)}; known are {', '.join(SECTIONS)}")
    if not arguments.only:
        raise InputError(f"only: expected at least one of {', '.join(SECTIONS)}")
    problems, skipped = _find(arguments)
    if arguments.list:
        for members in problems.values():
            for problem in members:
                print(problem.key)
        return 0
    methods, without = choose_pair_methods(arguments.methods)
    for line in (*skipped, *without):
        print(f"left out {line}", file=sys.stderr)
    # Pair by pair, so that a worker makes its clouds once.
    jobs = {
        name: [TrialJob(problem, method, START) for problem in members for method in methods_for(problem, methods)]
        for name, members in problems.items()
    }
    with open_journal(arguments) as journal:
        records = run_jobs(
            [job for members in jobs.values() for job in members], journal, placement(arguments), run=run_pair_trial
        )
        known = list(journal.records.values())
    body, content = "", {}
    for name in problems:
        own = [record for record in records if record["problem"]["section"] == name]
        text, content[name] = section_report(SECTIONS[name], own, known)
        body += text
    if skipped or without:
        body += "## Left out\n\n" + "".join(f"- {line}\n" for line in (*skipped, *without))
    used = dict.fromkeys(record["method"] for record in records)
    body += "\n## Methods\n\n" + "".join(
        f"- `{name}` ({METHODS[name].version()}): {METHODS[name].settings()}\n" for name in used
    )
    head = f"# Pairs of clouds\n\n`{command_line()}`\n\n{machine_note()}. One thread a registration.\n\n"
    write_text(arguments.output / "report.md", head + body)
    write_json(
        arguments.output / "report.json",
        {"command": command_line(), "machine": machine_note(), "sections": content, "trials": records},
    )
    print(f"report and every trial: {arguments.output}")
    return 0


def _find(arguments: argparse.Namespace) -> tuple[dict[str, Sequence[PairSource]], list[str]]:
    """The pairs of each section, and why something is left out. One section that was asked for must not be empty."""
    folder = data_folder(arguments)
    problems, skipped = {}, []
    for name in dict.fromkeys(arguments.only):
        try:
            problems[name], unusable = SECTIONS[name].find(folder)
            skipped += unusable
        except InputError as error:
            if len(arguments.only) == 1:
                raise
            skipped.append(f"{name}: {' '.join(str(error).split())}")
    if not problems:
        raise InputError(f"data: no section has a pair: {'; '.join(skipped)}")
    return problems, skipped


def choose_pair_methods(names: Sequence[str] | None) -> tuple[list[str], list[str]]:
    """The methods to run, and a line for each of the default ones that cannot, saying why.

    Raises
    ------
    InputError  if a name is not registered, cannot run here or is not made for 3D, or none is left.
    """
    chosen, skipped = [], []
    for name in DEFAULT_METHODS if names is None else names:
        if name in METHODS:
            reason = METHODS[name].missing() if 3 in METHODS[name].dimensions else "is not made for 3D"
        elif name in DEFAULT_METHODS:
            reason = "needs an adagmm_o3d that takes viewpoints"
        else:
            raise InputError(f"methods: unknown {name}; known are {', '.join(METHODS)}")
        if reason is None:
            chosen.append(name)
        elif names is None:
            skipped.append(f"{name}: {reason}")
        else:
            raise InputError(f"methods: {name} {reason}")
    if not chosen:
        raise InputError("methods: none is left to run")
    return chosen, skipped


def methods_for(problem: PairSource, names: Sequence[str]) -> list[str]:
    """The methods to run on a pair: those for dense clouds in place of those for a thousand points, and viewpoints only
    where they are known.
    """
    known = problem.facts()["section"] == RECORDINGS
    return [
        f"{name}-dense" if f"{name}-dense" in METHODS else name
        for name in names
        if known or name != "adagmm-viewpoints"
    ]


def section_report(section: Section, records: Sequence[dict], known: Sequence[dict]) -> tuple[str, dict]:
    """The tables of a section, printed and as markdown, and their content."""
    judged, left_out = judged_by_consensus(records, known, CONSENSUS)
    methods = list(dict.fromkeys(record["method"] for record in records))
    groups = by_group(judged, section.limit)
    title = f"{section.title}; found: {section.found}"
    tables = [("", found_table(groups, methods))] if len(groups) > 2 else []
    if ALL in groups:
        tables.append((f"{ALL}: ", error_table(groups[ALL], methods, section.unit, section.scale)))
    text = f"## {title[0].upper()}{title[1:]}\n\n"
    for prefix, (columns, rows) in tables:
        print_table(f"{prefix}{title}", columns, rows)
        text += markdown_table(columns, rows) + "\n"
    if any(record["problem"]["group"] == CONSENSUS for record in judged):
        note = (
            "By consensus: nobody measured the pose of these pairs; it is the one that most other libraries agree on, "
            "one of them without a start, so that they are judged by themselves there."
        )
        print(note)
        text += f"{note}\n\n"
    if left_out:
        note = f"Left out, no truth and no consensus: {', '.join(left_out)}."
        print(note)
        text += f"{note}\n\n"
    content = {
        group: {method: summary.as_dict() for method, summary in members.items()} for group, members in groups.items()
    }
    return text, {"groups": content, "left_out": left_out}
