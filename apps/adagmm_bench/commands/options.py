"""Options that several commands share, and what becomes of them."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from adagmm_bench.journal import Journal
from adagmm_bench.methods import Method, choose_methods
from adagmm_bench.models import default_data_folder
from adagmm_bench.problem import PREPARATIONS
from adagmm_bench.runner import Placement
from adagmm_bench.scenes import FramePair, find_frame_pairs
from adagmm_bench.trial import ProblemSource, TrialJob
from adagmm_fusion.files.atomic_file import check_output_file
from adagmm_fusion.processes.terminal import printable, say
from adagmm_o3d.errors import InputError

MAX_COUNT = 100_000  # of trials, seeds or repeats: all jobs are listed before the first runs
DEFAULT_STARTS = tuple(PREPARATIONS)


def words(text: str) -> tuple[str, ...]:
    """A list given as one word with commas."""
    return tuple(part for part in text.split(",") if part)


def add_output(parser: argparse.ArgumentParser, command: str) -> None:
    parser.add_argument(
        "--output", type=Path, default=Path("output", "bench", command), help="folder for results (default %(default)s)"
    )


def add_data(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--data", type=Path, help="folder with models and recordings (default $ADAGMM_SHARED_DATA, else ../shared/data)"
    )


def add_methods(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--methods", type=words, help="names with commas (default: all that run here)")
    parser.add_argument(
        "--starts",
        type=words,
        default=DEFAULT_STARTS,
        help=f"with commas: {'; '.join(f'{name}: {meaning}' for name, meaning in PREPARATIONS.items())} (default: all)",
    )


def add_trials(parser: argparse.ArgumentParser, command: str) -> None:
    """What a command that runs trials takes: --data, where they run, and --output."""
    add_data(parser)
    add_placement(parser)
    add_output(parser, command)


def add_placement(parser: argparse.ArgumentParser) -> None:
    """Where trials run, and whether from the beginning."""
    parser.add_argument("--workers", type=int, help="local processes (default: one a core)")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="run on the Dask cluster of this scheduler instead")
    parser.add_argument("--fresh", action="store_true", help="forget earlier results instead of continuing them")


def data_folder(arguments: argparse.Namespace) -> Path | None:
    """The folder that --data names, which must exist, or the default one if there is one."""
    if arguments.data is None:
        return default_data_folder()
    if not arguments.data.is_dir():
        raise InputError(f"{arguments.data}: --data names no folder")
    return arguments.data.resolve()


def check_count(name: str, value: int, most: int = MAX_COUNT) -> None:
    """Raise InputError unless an option's number is from 1 to `most`."""
    if not 1 <= value <= most:
        raise InputError(f"{name}: expected {'1 or more' if value < 1 else f'at most {most}'}, got {value}")


def say_left_out(lines: Sequence[str]) -> None:
    for line in lines:
        say(printable(f"left out {line}"))


def usable_frame_pairs(arguments: argparse.Namespace) -> tuple[list[FramePair], list[str]]:
    """The pairs of the recordings under --data, and why others are left out, which is printed too."""
    pairs, unusable = find_frame_pairs(data_folder(arguments))
    say_left_out(unusable)
    return pairs, unusable


def placement(arguments: argparse.Namespace) -> Placement:
    return Placement(arguments.workers, arguments.scheduler)


def chosen_methods(arguments: argparse.Namespace, dimension: int) -> tuple[list[Method], list[str]]:
    """Methods to run, and why others are left out, which is printed too."""
    chosen, skipped = choose_methods(arguments.methods, dimension)
    say_left_out(skipped)
    if not chosen:
        raise InputError("methods: none is left to run")
    return chosen, skipped


def chosen_starts(arguments: argparse.Namespace) -> tuple[str, ...]:
    if unknown := [start for start in arguments.starts if start not in PREPARATIONS]:
        raise InputError(f"starts: unknown {', '.join(unknown)}; known are {', '.join(PREPARATIONS)}")
    if not arguments.starts:
        raise InputError(f"starts: expected at least one of {', '.join(PREPARATIONS)}")
    return arguments.starts


def starts_of(method: Method, starts: tuple[str, ...]) -> tuple[str, ...]:
    """A method that works from anywhere is not run twice for starts that differ only in the pose."""
    if method.anywhere and {"as-given", "centroids"} <= set(starts):
        return tuple(start for start in starts if start != "as-given")
    return starts


def trial_jobs(problems: Sequence[ProblemSource], methods: Sequence[Method], starts: tuple[str, ...]) -> list[TrialJob]:
    """Every problem from every start by every method, one method after another."""
    return [
        TrialJob(problem, method.name, start)
        for method in methods
        for start in starts_of(method, starts)
        for problem in problems
    ]


def check_reports(arguments: argparse.Namespace) -> None:
    """Before the work: raise OutputError if the reports under --output cannot be written."""
    for name in ("report.md", "report.json"):
        check_output_file(arguments.output / name)


def open_journal(arguments: argparse.Namespace) -> Journal:
    """The results under --output. Raises OutputError if they cannot be written, or another run holds them."""
    check_reports(arguments)
    return Journal(arguments.output / "results.jsonl", fresh=arguments.fresh)
