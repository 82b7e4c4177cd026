"""`adagmm-fusion run` on a folder of recordings: each a task of its own, on local processes or on a cluster."""

import argparse
import contextlib
import copy
import io
import json
import statistics
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from adagmm_fusion.commands.run import run, verdict
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.stale_results import REPORTS, check_not_foreign, results_of_report
from adagmm_fusion.formats import matching
from adagmm_fusion.pairs.joint_report import RecordingSummary, joint_markdown, write_joint_report
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.processes.task_pool import TaskFailure, run_tasks
from adagmm_fusion.processes.terminal import printable
from adagmm_fusion.recordings.opening import recordings_inside
from adagmm_fusion.rerun_arguments import logs_to_file
from adagmm_fusion.rerun_log.joint_recording import save_joint_recording


@dataclass(frozen=True)
class RecordingTask:
    """One recording to run: the command line's arguments, with its own folder and output."""

    arguments: argparse.Namespace
    settings: Settings


@dataclass(frozen=True)
class RecordingResult:
    """What a run wrote into its report, summed up: pairs that succeeded, pairs in all, median errors where known."""

    ok: int
    pairs: int
    rotation_deg: float | None
    translation_mm: float | None
    report: str


def recordings_in(path: str | Path) -> list[Path]:
    """The recordings among a folder's subfolders; none if the folder is a recording itself, or no folder.

    Raises
    ------
    RecordingError : the folder cannot be looked into.
    """
    folder = Path(path)
    try:
        return recordings_inside(folder) if folder.is_dir() and not matching(folder) else []
    except OSError as problem:
        raise RecordingError(f"{folder}: cannot be read: {problem.strerror}") from problem


def run_many(recordings: list[Path], args: argparse.Namespace, settings: Settings) -> int:
    """Run every recording; returns 1 if one could not be run, else the `verdict` on the pairs of all.

    Each has the files of a run of its own; beside them are one report and one Rerun recording of all.

    Raises
    ------
    RecordingError : options that only make sense for one recording.
    """
    for option, value in (("--pairs", args.pairs), ("--save", args.save), ("--calibration", args.calibration)):
        if value is not None:
            raise RecordingError(f"{args.recording}: a folder of {len(recordings)} recordings; {option} is for one")
    output = Path(args.output) if args.output else Path("output") / Path(args.recording).resolve().name
    joint = output / f"{output.name}.rrd"
    own_names = [*REPORTS, joint.name] if logs_to_file(args) else REPORTS
    check_not_foreign(output, own_names, results_of_report(output))
    tasks = {path.name: RecordingTask(_for_one(args, path, output), settings) for path in recordings}
    results = dict(run_tasks(run_recording, tasks, workers=args.workers, scheduler=args.scheduler))
    headings = map(_text, ("recording", "ok", "pairs", "median [°]", "median [mm]"))
    table = Table(*map(Column, headings), Column("report", overflow="fold"))
    for name in tasks:
        result = results[name]
        if isinstance(result, TaskFailure):
            table.add_row(_text(name), "-", "-", "-", "-", _text(f"failed: {result.reason}"))
        else:
            numbers = (_shown(result.rotation_deg, 2), _shown(result.translation_mm, 0))
            table.add_row(_text(name), str(result.ok), str(result.pairs), *numbers, _text(result.report))
    summaries = [_summary(name, results[name]) for name in tasks]
    paths = write_joint_report(output, output.name, summaries)
    if not args.quiet:
        Console().print(table)
        print(printable(f"report: {paths[0]}, {paths[1]}"))
    if logs_to_file(args):
        logged = [
            output / summary.folder / summary.report["results"]["Rerun recording"]
            for summary in summaries
            if summary.report is not None
        ]
        save_joint_recording(joint, output.name, joint_markdown(output.name, summaries), logged)
        if not args.quiet:
            print(printable(f"Rerun recording of all: {joint}"))
    done = [result for result in results.values() if isinstance(result, RecordingResult)]
    if len(done) < len(results):
        return 1
    return verdict(sum(result.ok for result in done), sum(result.pairs for result in done), strict=args.strict)


def _summary(name: str, result: RecordingResult | TaskFailure) -> RecordingSummary:
    if isinstance(result, TaskFailure):
        return RecordingSummary(name, name, None, result.reason)
    return RecordingSummary(name, name, json.loads(Path(result.report).read_text(encoding="utf-8")))


def run_recording(task: RecordingTask) -> RecordingResult:
    """Run one recording and read its report; what it would print is in the report."""
    with contextlib.redirect_stdout(io.StringIO()):
        run(task.arguments, task.settings)
    path = Path(task.arguments.output) / "report.json"
    pairs = json.loads(path.read_text(encoding="utf-8"))["pairs"]

    def median(key: str) -> float | None:
        known = [pair[key] for pair in pairs if pair[key] is not None]
        return statistics.median(known) if known else None

    ok = sum(pair["status"] == "ok" for pair in pairs)
    return RecordingResult(ok, len(pairs), median("rotation_error_deg"), median("translation_error_mm"), str(path))


def _for_one(args: argparse.Namespace, recording: Path, output: Path) -> argparse.Namespace:
    one = copy.copy(args)
    one.recording, one.output = str(recording.resolve()), str((output / recording.name).resolve())
    return one


def _text(words: str) -> Text:
    """Words as they are: rich would take a unit or a name in brackets for markup."""
    return Text(printable(words))


def _shown(number: float | None, digits: int) -> str:
    return "-" if number is None else f"{number:.{digits}f}"
