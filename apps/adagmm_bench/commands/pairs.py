"""`pairs`: clouds as people bring them, from any start, at any overlap: who finds the pose, and who knows."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from adagmm_bench.commands.options import (
    add_trials,
    check_count,
    data_folder,
    open_journal,
    placement,
    say_left_out,
    words,
)
from adagmm_bench.methods import METHODS
from adagmm_bench.pairs.problem import PairSource
from adagmm_bench.pairs.sections import SECTIONS, judged, methods_for
from adagmm_bench.pairs.tables import by_group
from adagmm_bench.pairs.trial import run_pair_trial
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table, write_json
from adagmm_bench.runner import run_jobs
from adagmm_bench.trial import TrialJob
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.errors import InputError

START = "as-given"
TRIALS = 20
DEFAULT_METHODS = (
    "adagmm",
    "adagmm-global",
    "adagmm-viewpoints",
    "open3d-ransac-gicp",
    "kiss-matcher-gicp",
    "open3d-gicp",
    "small-gicp",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--methods", type=words, help=f"names with commas (default: {','.join(DEFAULT_METHODS)}, those that run here)"
    )
    parser.add_argument(
        "--only", type=words, default=tuple(SECTIONS), help=f"sections with commas (default: {','.join(SECTIONS)})"
    )
    parser.add_argument("--list", action="store_true", help="name the pairs and end")
    parser.add_argument("--trials", type=int, default=TRIALS, help="of each made pair (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of the made pairs (default %(default)s)")
    add_trials(parser, "pairs")


def run(arguments: argparse.Namespace) -> int:
    pairs, skipped = find_pairs(arguments)
    if arguments.list:
        print("\n".join(printable(pair.key) for members in pairs.values() for pair in members))
        return 0
    methods, without = choose_pair_methods(arguments.methods)
    skipped += without
    say_left_out(skipped)
    # Pair by pair, so that a worker makes its clouds once.
    jobs = [
        TrialJob(pair, method, START)
        for members in pairs.values()
        for pair in members
        for method in methods_for(pair, methods)
    ]
    if not jobs:
        raise InputError(f"methods: none of {', '.join(methods)} takes part in {', '.join(pairs)}")
    with open_journal(arguments) as journal:
        records = run_jobs(jobs, journal, placement(arguments), run=run_pair_trial)
        everything, notes = judged(records, list(journal.records.values()))
    text = f"# Pairs of clouds\n\n`{command_line()}`\n\n{machine_note()}. One thread a registration.\n\n"
    summaries = {}
    for name in pairs:
        own = [record for record in everything if record["problem"]["section"] == name]
        text += f"## {name}: {SECTIONS[name].title}\n\n"
        for title, columns, rows in SECTIONS[name].tables(own, everything):
            print_table(f"{name}, {title}: {SECTIONS[name].title}", columns, rows)
            text += f"{title[0].upper()}{title[1:]}:\n\n{markdown_table(columns, rows)}\n"
        summaries[name] = {
            group: {method: summary.as_dict() for method, summary in members.items()}
            for group, members in by_group(own).items()
        }
    for note in notes:
        print(printable(note))
    text += "".join(f"{note}\n\n" for note in notes)
    if skipped:
        text += "## Left out\n\n" + "".join(f"- {line}\n" for line in skipped) + "\n"
    text += "## Methods\n\n" + "".join(
        f"- `{name}` ({METHODS[name].version()}): {METHODS[name].settings()}\n"
        for name in dict.fromkeys(record["method"] for record in records)
    )
    write_text(arguments.output / "report.md", text)
    head = {"command": command_line(), "machine": machine_note(), "left_out": skipped, "notes": notes}
    write_json(arguments.output / "report.json", head | {"sections": summaries, "trials": records})
    print(printable(f"report and every trial: {arguments.output}"))
    return 0


def find_pairs(arguments: argparse.Namespace) -> tuple[dict[str, Sequence[PairSource]], list[str]]:
    """The pairs of each section that was asked for, and why something is left out.

    Raises
    ------
    InputError  if an option is out of its range, or no section has a pair.
    """
    if unknown := [name for name in arguments.only if name not in SECTIONS]:
        raise InputError(f"only: unknown {', '.join(unknown)}; known are {', '.join(SECTIONS)}")
    if not arguments.only:
        raise InputError(f"only: expected at least one of {', '.join(SECTIONS)}")
    check_count("trials", arguments.trials)
    if arguments.seed < 0:
        raise InputError(f"seed: expected 0 or more, got {arguments.seed}")
    folder = data_folder(arguments)
    pairs: dict[str, Sequence[PairSource]] = {}
    skipped: list[str] = []
    for name in dict.fromkeys(arguments.only):
        try:
            pairs[name], unusable = SECTIONS[name].find(folder, trials=arguments.trials, seed=arguments.seed)
            skipped += unusable
        except InputError as error:
            skipped.append(f"{name}: {error}")
    skipped = list(dict.fromkeys(" ".join(line.split()) for line in skipped))
    if not pairs:
        raise InputError(f"only: no section has a pair: {'; '.join(skipped)}")
    return pairs, skipped


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
