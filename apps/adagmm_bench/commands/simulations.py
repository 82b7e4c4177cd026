"""`sim2d` and `sim3d`: the paper's Section 4.1, its Figures 6 to 9 and 13 to 16 and its Tables 2 and 4."""

from __future__ import annotations

import argparse

from adagmm_bench.commands.options import (
    add_methods,
    add_trials,
    check_count,
    chosen_methods,
    chosen_starts,
    data_folder,
    open_journal,
    placement,
    trial_jobs,
    words,
)
from adagmm_bench.methods import METHODS
from adagmm_bench.models import find_models
from adagmm_bench.plots import MAX_LINES, plot_sweep
from adagmm_bench.report import (
    command_line,
    machine_note,
    markdown_table,
    print_table,
    settings_section,
    summaries_as_json,
    write_json,
)
from adagmm_bench.runner import run_jobs
from adagmm_bench.simulation import REPETITIONS, SWEEPS, trial_ids
from adagmm_bench.summary import FOUND_ROTATION_ERROR, Summary, best_start, by_setting, summarise
from adagmm_bench.trial import SimulatedProblem
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.processes.terminal import printable

FIGURES = {
    2: {"rotation": 6, "noise": 7, "outliers": 8, "occlusion": 9},
    3: {"rotation": 13, "noise": 14, "outliers": 15, "occlusion": 16},
}
RUNNING_TIME_TABLE = {2: 2, 3: 4}
PUBLISHED_SECONDS = {
    2: {"point-to-plane ICP": 1.89, "CPD": 27.94, "theirs (GTX 1080)": 622.52},
    3: {"point-to-plane ICP": 29.81, "GICP": 274.36, "CPD": 429.52, "theirs (GTX 1080)": 2820.32},
}


def add_arguments(parser: argparse.ArgumentParser, dimension: int) -> None:
    parser.add_argument("--sweeps", type=words_of_sweeps, default=tuple(SWEEPS), help="with commas (default: all four)")
    parser.add_argument("--trials", type=int, default=REPETITIONS, help="trials a setting (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="default %(default)s")
    parser.add_argument(
        "--rotation-range",
        type=float,
        metavar="DEG",
        help="start rotations up to this about each axis where rotation is not swept (default 15; 180 in 3D: any)",
    )
    add_methods(parser)
    add_trials(parser, f"sim{dimension}d")


def words_of_sweeps(text: str) -> tuple[str, ...]:
    names = words(text)
    if not names or not set(names) <= set(SWEEPS):
        raise argparse.ArgumentTypeError(f"expected some of {','.join(SWEEPS)}, got {text!r}")
    return names


def run(arguments: argparse.Namespace, dimension: int) -> int:
    check_count("trials", arguments.trials)
    methods, skipped = chosen_methods(arguments, dimension)
    starts = chosen_starts(arguments)
    models_path = find_models(dimension, data_folder(arguments))
    problems = [
        SimulatedProblem(trial_id, models_path)
        for trial_id in trial_ids(
            dimension,
            sweeps=arguments.sweeps,
            repetitions=arguments.trials,
            seed=arguments.seed,
            rotation_range_deg=arguments.rotation_range,
        )
    ]
    jobs = trial_jobs(problems, methods, starts)
    with open_journal(arguments) as journal:
        records = run_jobs(jobs, journal, placement(arguments))
    models = models_path.name if models_path else "shapes made by the bench"
    write_report(arguments, dimension, models, records, skipped)
    return 0


def write_report(
    arguments: argparse.Namespace, dimension: int, models: str, records: list[dict], skipped: list[str]
) -> None:
    """Figures, markdown and JSON under --output, and the table on the terminal."""
    summaries = summarise(records)
    columns, rows = overall_table(summaries, arguments.sweeps, records)
    shown = lines_to_plot(summaries)
    figures = []
    for sweep in arguments.sweeps:
        number = FIGURES[dimension][sweep]
        lines = by_setting(records, sweep)
        path = arguments.output / f"figure_{number:02d}_{sweep}.png"
        title = f"{dimension}D, {sweep} (the paper's Figure {number}): mean and standard deviation"
        plot_sweep(path, title, sweep, {s.label: lines[s.method, s.start] for s in shown})
        figures.append(path.name)
    trials = len(records) // len(summaries)
    head = (
        f"# The paper's {dimension}D simulations\n\n`{command_line()}`\n\n{machine_note()}. Models: {models}. "
        f"{trials} trials a row, seed {arguments.seed}. Error: ‖I − R_gt R⁻¹‖_F; found: within "
        f"{FOUND_ROTATION_ERROR:g}. A method that gave up counts with the error of its start. Seconds: sum over the "
        "trials, one thread.\n\n"
    )
    published = ", ".join(f"{name} {seconds:g} s" for name, seconds in PUBLISHED_SECONDS[dimension].items())
    text = head + markdown_table(columns, rows)
    text += f"\nThe paper's Table {RUNNING_TIME_TABLE[dimension]}, 282 trials: {published}.\n\n"
    for sweep, figure in zip(arguments.sweeps, figures, strict=True):
        text += f"## {sweep.capitalize()}\n\n![{sweep}]({figure})\n\n{setting_table(records, sweep, summaries)}\n"
    text += settings_section(dict.fromkeys(s.method for s in summaries), skipped)
    write_text(arguments.output / "report.md", text)
    write_json(
        arguments.output / "report.json",
        {
            "command": command_line(),
            "machine": machine_note(),
            "models": models,
            "seed": arguments.seed,
            "left_out": skipped,
            "summaries": summaries_as_json(summaries),
            "trials": records,
        },
    )
    print_table(f"{dimension}D, {trials} trials a row, {models}", columns, rows)
    print(printable(f"report, figures and every trial: {arguments.output}"))


def overall_table(
    summaries: list[Summary], sweeps: tuple[str, ...], records: list[dict]
) -> tuple[list[str], list[list]]:
    """A row for each method and start: over all sweeps, then the mean of each."""
    of_sweep = {
        sweep: {s.label: s for s in summarise(r for r in records if r["problem"]["sweep"] == sweep)} for sweep in sweeps
    }
    columns = ["method (start)", "mean", "std", "median", "found", "gave up", *sweeps]
    columns += ["translation", "seconds", "CPU s"]
    rows = [
        [
            s.label,
            f"{s.mean:.3f}",
            f"{s.std:.3f}",
            f"{s.median:.4f}",
            f"{s.found}/{s.trials}",
            s.failed,
            *(f"{of_sweep[sweep][s.label].mean:.3f}" for sweep in sweeps),
            f"{s.translation_mean:.3f}",
            f"{s.seconds_total:.2f}",
            f"{s.cpu_seconds_total:.2f}",
        ]
        for s in summaries
    ]
    return columns, rows


def setting_table(records: list[dict], sweep: str, summaries: list[Summary]) -> str:
    """Mean ± standard deviation per setting, methods in the order of the overall table."""
    lines = by_setting(records, sweep)
    settings = sorted({setting for line in lines.values() for setting in line})
    rows = [
        [s.label, *("{:.3f} ± {:.3f}".format(*lines[s.method, s.start][setting]) for setting in settings)]
        for s in summaries
    ]
    return markdown_table(["method (start)", *(f"{setting:g}" for setting in settings)], rows)


def lines_to_plot(summaries: list[Summary]) -> list[Summary]:
    """Ours first, its default before its variants, then the best others, each at its best start."""
    best = best_start(summaries)
    ours = sorted((s for s in best if METHODS[s.method].ours), key=lambda s: (s.method != "adagmm", s.mean))[:3]
    peers = [s for s in best if not METHODS[s.method].ours]
    return ours + peers[: MAX_LINES - len(ours)]
