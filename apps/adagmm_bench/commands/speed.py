"""`speed`: ratios of medians in one run, beside other libraries; exit code 1 where one has grown by 20 %."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from adagmm_bench.commands.options import add_data, add_output, check_count, check_reports, data_folder, words
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table, write_json
from adagmm_bench.speed.kernel import kernel
from adagmm_bench.speed.large import frames, scaling
from adagmm_bench.speed.measurement import Measurement
from adagmm_bench.speed.registrations import kinect, simulations
from adagmm_bench.speed.startup import startup
from adagmm_fusion.files.atomic_file import check_output_file, write_text
from adagmm_fusion.files.input_file import read_input_text
from adagmm_fusion.processes.task_pool import TaskFailure, run_tasks
from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.errors import AdaGMMError, InputError

RECORDED = Path(__file__).resolve().parents[1] / "recorded_ratios.json"
TOLERANCE = 1.20
SECTIONS = ("kinect", "sim3d", "sim2d", "kernel", "startup", "frames", "scaling")
DEFAULT_SECTIONS = SECTIONS[:5]


class SpeedError(AdaGMMError, RuntimeError):
    """A section could not be measured."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--sections",
        type=words,
        default=DEFAULT_SECTIONS,
        help=f"of {', '.join(SECTIONS)}, with commas, or all (default: {','.join(DEFAULT_SECTIONS)})",
    )
    parser.add_argument("--repeats", type=int, default=5, help="default %(default)s")
    parser.add_argument(
        "--recorded", type=Path, default=RECORDED, help="ratios to compare with (default: those shipped)"
    )
    parser.add_argument("--record", action="store_true", help="write this run's ratios there instead of comparing")
    add_data(parser)
    add_output(parser, "speed")


def run(arguments: argparse.Namespace) -> int:
    sections = SECTIONS if arguments.sections == ("all",) else arguments.sections
    if unknown := [section for section in sections if section not in SECTIONS]:
        raise InputError(f"sections: unknown {', '.join(unknown)}; known are {', '.join(SECTIONS)}, all")
    check_count("repeats", arguments.repeats)
    check_reports(arguments)
    if arguments.record:
        check_output_file(arguments.recorded)
    recorded = {} if arguments.record else read_recorded(arguments.recorded)
    measurements: list[Measurement] = []
    for section in sections:
        print(f"measuring {section} ...", file=sys.stderr, flush=True)
        # A fresh process for each: one thread, one core, and a peak of memory of its own.
        task = (section, data_folder(arguments), arguments.repeats)
        ((_, result),) = run_tasks(measure, {section: task}, workers=1)
        if isinstance(result, TaskFailure):
            raise SpeedError(f"{section}: {result.reason}")
        measurements += result
    regressions = find_regressions(measurements, recorded)
    write_report(arguments.output, measurements, recorded, regressions)
    if arguments.record:
        record(arguments.recorded, measurements)
        print(printable(f"recorded in {arguments.recorded}"))
    for line in regressions:
        print(f"regression: {line}", file=sys.stderr)
    return 1 if regressions else 0


def measure(task: tuple[str, Path | None, int]) -> list[Measurement]:
    """One section, in a worker of its own."""
    section, folder, repeats = task
    measures = {
        "kinect": lambda: kinect(folder, repeats),
        "sim3d": lambda: simulations(3, folder, repeats),
        "sim2d": lambda: simulations(2, folder, repeats),
        "kernel": lambda: kernel(repeats),
        "startup": lambda: startup(repeats),
        "frames": frames,
        "scaling": scaling,
    }
    return measures[section]()


def read_recorded(path: Path) -> dict[str, float]:
    """Ratios by name.

    Raises
    ------
    InputError  if the file is not there or is not what `record` writes.
    """
    try:
        ratios = json.loads(read_input_text(path, InputError))["ratios"]
        return {str(key): float(value) for key, value in ratios.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: expected recorded ratios, as --record writes them, got {error!r}") from error


def record(path: Path, measurements: Sequence[Measurement]) -> None:
    """Keep the ratios of this run; those of sections that were not measured stay as they were."""
    kept = read_recorded(path) if path.is_file() else {}
    ratios = kept | {m.key: round(m.value, 4) for m in measurements if m.cost}
    write_json(path, {"machine": machine_note(), "ratios": dict(sorted(ratios.items()))})


def find_regressions(measurements: Sequence[Measurement], recorded: dict[str, float]) -> list[str]:
    """A line for each ratio that is more than 20 % above the recorded one."""
    return [
        f"{m.key} is {m.value:.3g}, recorded {recorded[m.key]:.3g}, allowed {TOLERANCE * recorded[m.key]:.3g}"
        for m in measurements
        if m.cost and m.key in recorded and m.value > TOLERANCE * recorded[m.key]
    ]


def write_report(
    folder: Path, measurements: Sequence[Measurement], recorded: dict[str, float], regressions: Sequence[str]
) -> None:
    columns = ["what", "measured", "unit", "goal", "recorded"]
    rows = [
        [
            m.key,
            f"{m.value:.3g}",
            m.unit,
            "" if m.goal is None else f"≤ {m.goal:g} {'met' if m.value <= m.goal else 'missed'}",
            f"{recorded[m.key]:.3g}" if m.key in recorded else "",
        ]
        for m in measurements
    ]
    text = (
        f"# Speed\n\n`{command_line()}`\n\n{machine_note()}. CPU seconds of one thread on one core; the libraries take "
        "turns on each pair, so that ratios hold where the machine is shared. Whole registrations, default options, "
        "code warm.\n\n"
        f"{markdown_table(columns, rows)}"
    )
    text += "".join(f"\nRegression: {line}\n" for line in regressions)
    write_text(folder / "report.md", text)
    write_json(
        folder / "report.json",
        {
            "command": command_line(),
            "machine": machine_note(),
            "measurements": [asdict(m) for m in measurements],
            "regressions": list(regressions),
        },
    )
    print_table("speed, one thread", columns, rows)
    print(printable(f"report: {folder}"))
