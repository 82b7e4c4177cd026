"""`ablation`: what each choice of the default is worth, by undoing one at a time, on all that has a known truth; those
about colours on coloured pairs of frames."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence

from adagmm_bench.color_table import COLUMNS, color_methods, color_rows, color_text, run_color_trials
from adagmm_bench.color_trial import VARIANTS
from adagmm_bench.commands.kinect import found as found_scene
from adagmm_bench.commands.options import (
    add_trials,
    check_count,
    data_folder,
    open_journal,
    placement,
    usable_frame_pairs,
)
from adagmm_bench.extra_pairs import LOST, DenseSurface, OppositeSides, found_part
from adagmm_bench.methods.ablations import ABLATIONS
from adagmm_bench.models import find_models
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
from adagmm_bench.scenes import find_scenes
from adagmm_bench.simulation import REPETITIONS, trial_ids
from adagmm_bench.summary import Summary, found_in_simulation, summarise
from adagmm_bench.trial import ProblemSource, SimulatedProblem, TrialJob
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.processes.terminal import printable, say
from adagmm_o3d.errors import InputError

START = "as-given"  # so that what the default does about translation counts too
NAMES = ("adagmm", *ABLATIONS)
FOUND = {"Kinect": found_scene, "sides": found_part}
# Pairs without opposite sides in each dimension, and points of the dense surfaces: some choices were made for these.
SIDES = 12
DENSE_POINTS = (25_000, 50_000, 100_000)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--trials", type=int, default=REPETITIONS, help="trials a setting (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="default %(default)s")
    add_trials(parser, "ablation")


def run(arguments: argparse.Namespace) -> int:
    check_count("trials", arguments.trials)
    folder = data_folder(arguments)
    problems: dict[str, Sequence[ProblemSource]] = {
        f"{dimension}D": [
            SimulatedProblem(trial_id, find_models(dimension, folder))
            for trial_id in trial_ids(dimension, repetitions=arguments.trials, seed=arguments.seed)
        ]
        for dimension in (2, 3)
    }
    try:
        problems["Kinect"] = find_scenes(folder)
    except InputError as error:
        say(printable(f"left out the Kinect scenes: {error}"))
    problems["sides"] = [
        OppositeSides(dimension, trial, arguments.seed, find_models(dimension, folder))
        for dimension in (2, 3)
        for trial in range(SIDES)
    ]
    problems["dense"] = [DenseSurface(points) for points in DENSE_POINTS]
    try:
        coloured, _ = usable_frame_pairs(arguments)
    except InputError as error:
        coloured = []
        say(printable(f"left out the coloured pairs: {error}"))
    with open_journal(arguments) as journal:
        jobs = [TrialJob(problem, name, START) for group in problems.values() for name in NAMES for problem in group]
        records = run_jobs(jobs, journal, placement(arguments))
        of_colours = run_color_trials(coloured, tuple(VARIANTS), journal, placement(arguments))
    keys = {group: {problem.key for problem in members} for group, members in problems.items()}
    summaries = {
        group: {s.method: s for s in summarise(_of(records, members), FOUND.get(group, found_in_simulation))}
        for group, members in keys.items()
    }
    columns, rows = ablation_table(summaries)
    table = markdown_table(columns, rows)
    text = (
        f"# What each choice is worth\n\n`{command_line()}`\n\n{machine_note()}. Start: {START}, seed "
        f"{arguments.seed}. Mean rotation error ‖I − R_gt R⁻¹‖_F and how many were found: within 0.1 in the "
        "simulations and dense, within 10° and 0.2 m on the Kinect scenes. CPU seconds: sum over the trials. Sides: "
        f"{SIDES} pairs in 2D and in 3D that lost {LOST:.0%} of their points on opposite sides, found with the "
        f"translation within 0.1 radii too. Dense: surfaces of {', '.join(map(str, DENSE_POINTS))} points.\n\n"
        f"{table}\n{settings_section(NAMES, [])}"
    )
    if of_colours:
        rows = color_rows(of_colours, tuple(VARIANTS))
        text += (
            f"\n## What is about colours\n\n{color_text()}\n\n{markdown_table(COLUMNS, rows)}\n"
            f"{color_methods(tuple(VARIANTS))}"
        )
    write_text(arguments.output / "report.md", text)
    write_json(
        arguments.output / "report.json",
        {
            "command": command_line(),
            "machine": machine_note(),
            "summaries": {group: summaries_as_json(members.values()) for group, members in summaries.items()},
            "trials": records + of_colours,
        },
    )
    for group, members in summaries.items():
        print_table(f"one choice undone at a time: {group}", *ablation_table({group: members}))
    if of_colours:
        print_table("one choice about colours undone at a time", COLUMNS, rows)
    print(printable(f"report and every trial: {arguments.output}"))
    return 0


def _of(records: list[dict], keys: set[str]) -> list[dict]:
    """The records of some problems, by the first part of their key."""
    return [record for record in records if record["key"].split(" | ")[0] in keys]


def ablation_table(summaries: Mapping[str, Mapping[str, Summary]]) -> tuple[list[str], list[list]]:
    columns = ["method"]
    for group in summaries:
        columns += [f"{group} mean", "found", "translation", "CPU s"]
    rows = []
    for name in NAMES:
        row = [name]
        for members in summaries.values():
            s = members[name]
            row += [f"{s.mean:.3g}", f"{s.found}/{s.trials}", f"{s.translation_mean:.3g}", f"{s.cpu_seconds_total:.2f}"]
        rows.append(row)
    return columns, rows
