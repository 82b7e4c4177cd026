"""Whole registrations with the default options, covariances given, code warm, one thread, beside what people use."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.models import find_models, load_models
from adagmm_bench.scenes import find_scenes
from adagmm_bench.simulation import simulate, trial_ids
from adagmm_bench.speed.measurement import Measurement, interleaved_seconds

OURS = "adagmm"
START = "centroids"
SCENES = 6
KINECT_GOALS = {"open3d-gicp": 1.0}
SIMULATION_GOALS = {3: {"small-gicp": 1.0}, 2: {}}
PEERS = ("open3d-point-to-plane", "open3d-gicp", "open3d-gicp-covariances", "small-gicp", "small-vgicp")
SEED = 0
EVERY = 6  # of the 282 trials, one of each setting
GOAL_2D_SECONDS = 2.0  # for all 282


def kinect(data_folder: Path | None, repeats: int) -> list[Measurement]:
    """The ratio of medians over some of the paper's Kinect scenes, about 4000 points a cloud."""
    every = find_scenes(data_folder)
    scenes = [scene.load() for scene in every[:: max(1, len(every) // SCENES)][:SCENES]]
    return _beside_peers("kinect", scenes, repeats, KINECT_GOALS)


def simulations(dimension: int, data_folder: Path | None, repeats: int) -> list[Measurement]:
    """One trial of each setting of the sweeps: about 100 points a cloud in 2D, 1000 in 3D."""
    models = load_models(dimension, find_models(dimension, data_folder)).models
    problems = [simulate(trial_id, models) for trial_id in trial_ids(dimension, repetitions=1, seed=SEED)]
    return _beside_peers(f"sim{dimension}d", problems, repeats, SIMULATION_GOALS[dimension])


def _beside_peers(section: str, problems: list, repeats: int, goals: dict[str, float]) -> list[Measurement]:
    peers = [name for name in PEERS if METHODS[name].missing() is None]
    seconds = interleaved_seconds([OURS, *peers], problems, START, repeats)
    lines = [
        Measurement(section, f"{name}, median of a pair", 1000 * float(np.median(values)), "ms")
        for name, values in seconds.items()
    ]
    if section.startswith("sim"):
        # A sweep's time is the sum: hard pairs take longer, and there are many. The median is over repeats only.
        totals = {name: float(np.median(values.sum(axis=1))) for name, values in seconds.items()}
        goal = GOAL_2D_SECONDS if section == "sim2d" else None
        lines.append(Measurement(section, f"{OURS}, all 282 trials", EVERY * totals[OURS], "s", goal=goal))
        costs = {name: totals[OURS] / totals[name] for name in peers}
    else:
        costs = {name: float(np.median(seconds[OURS]) / np.median(seconds[name])) for name in peers}
    for name, cost in costs.items():
        lines.append(Measurement(section, f"{OURS} / {name}", cost, "×", cost=True, goal=goals.get(name)))
    return lines
