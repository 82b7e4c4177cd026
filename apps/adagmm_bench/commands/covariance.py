"""`covariance`: whether true errors are as large as the pose covariance says: simulations, scenes, rendered rooms."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

import numpy as np

from adagmm_bench.commands.kinect import found as found_scene
from adagmm_bench.commands.options import (
    add_trials,
    check_count,
    data_folder,
    open_journal,
    placement,
)
from adagmm_bench.covariance_trial import run_covariance_trial
from adagmm_bench.models import find_models
from adagmm_bench.rendered import CAMERAS, RenderedPair, run_rendered_trial
from adagmm_bench.rendered import is_found as found_rendered
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table, write_json
from adagmm_bench.runner import run_jobs
from adagmm_bench.scenes import find_scenes
from adagmm_bench.simulation import REPETITIONS, SWEEPS, trial_ids
from adagmm_bench.summary import found_in_simulation
from adagmm_bench.trial import SimulatedProblem, TrialJob
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.processes.terminal import printable, say
from adagmm_o3d.errors import InputError

METHOD, START = "adagmm", "centroids"
DIRECTIONS = {2: 3, 3: 6}
COLUMNS = ["errors squared, normalised", "directions", "mean", "standard error", "median", "90 %", "found", "free"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--trials", type=int, default=REPETITIONS, help="trials a setting (default %(default)s)")
    parser.add_argument("--seeds", type=int, default=2, help="how many, from 0 on (default %(default)s)")
    parser.add_argument("--rooms", type=int, default=6, help="rendered for each pair of cameras (default %(default)s)")
    add_trials(parser, "covariance")


def run(arguments: argparse.Namespace) -> int:
    for name in ("trials", "seeds", "rooms"):
        check_count(name, getattr(arguments, name))
    folder = data_folder(arguments)
    groups = {
        dimension: [
            TrialJob(SimulatedProblem(trial_id, find_models(dimension, folder)), METHOD, START)
            for seed in range(arguments.seeds)
            for trial_id in trial_ids(dimension, repetitions=arguments.trials, seed=seed)
        ]
        for dimension in DIRECTIONS
    }
    scenes = []
    try:
        scenes = [TrialJob(scene, METHOD, START) for scene in find_scenes(folder)]
    except InputError as error:
        say(printable(f"left out the Kinect scenes: {error}"))
    rendered = [
        TrialJob(RenderedPair(cameras, room), METHOD, "the app's")
        for cameras in CAMERAS
        for room in range(arguments.rooms)
    ]
    with open_journal(arguments) as journal:
        records = run_jobs([*groups[2], *groups[3], *scenes], journal, placement(arguments), run=run_covariance_trial)
        by_app = run_jobs(rendered, journal, placement(arguments), run=run_rendered_trial)
    rows = []
    for dimension in DIRECTIONS:
        own = [record for record in records if record["problem"].get("dimension") == dimension]
        rows.append(row(f"{dimension}D", DIRECTIONS[dimension], own, found_in_simulation))
        for sweep in SWEEPS:
            swept = [record for record in own if record["problem"]["sweep"] == sweep]
            rows.append(row(f"{dimension}D, {sweep}", DIRECTIONS[dimension], swept, found_in_simulation))
    if scenes:
        rows.append(row("Kinect scenes", DIRECTIONS[3], records[-len(scenes) :], found_scene))
    for cameras in CAMERAS:
        own = [record for record in by_app if record["problem"]["cameras"] == cameras]
        rows.append(row(f"rendered rooms by the app, {cameras}", DIRECTIONS[3], own, found_rendered))
    text = (
        f"# How honest the pose covariance is\n\n`{command_line()}`\n\n{machine_note()}. δᵀ C⁻¹ δ with exp(δ)·T the "
        "truth, over the trials whose pose was found (within 0.1 in the simulations, within 10° and 0.2 m on the "
        "scenes, 3° and 0.1 m in the rendered rooms): its mean should be the number of directions, for six of them its "
        "median 5.3 and nine tenths of it below 10.6. Free: trials in which the shape or the noise leaves a "
        f"direction free. Start: {START}; {arguments.seeds} seeds, {arguments.trials} trials a setting. The scenes' "
        "ground truth is itself only good to about 1.4° and 25 mm.\n\n"
        f"{markdown_table(COLUMNS, rows)}"
    )
    write_text(arguments.output / "report.md", text)
    content = {"command": command_line(), "machine": machine_note(), "columns": COLUMNS, "rows": rows}
    write_json(arguments.output / "report.json", content | {"trials": [*records, *by_app]})
    print_table("how honest the pose covariance is", COLUMNS, rows)
    print(printable(f"report and every trial: {arguments.output}"))
    return 0


def row(name: str, directions: int, records: Sequence[dict], is_found: Callable[[dict], bool]) -> list:
    """What became of the records whose pose was found."""
    found = [record for record in records if is_found(record)]
    squares = np.array([record["nees"] for record in found if record["nees"] is not None])
    figures = ["-"] * 4
    if len(squares):
        error = squares.std() / np.sqrt(len(squares))
        figures = [f"{figure:.2f}" for figure in (squares.mean(), error, np.median(squares), np.quantile(squares, 0.9))]
    free = sum(record["free"] > 0 for record in found)
    return [name, directions, *figures, f"{len(found)}/{len(records)}", free]
