"""`replay`: one trial again, alone, by what names it; its record in full, and the clouds in Rerun if asked for."""

from __future__ import annotations

import argparse
import json

import numpy as np

from adagmm_bench.commands.options import add_data, data_folder
from adagmm_bench.methods import METHODS
from adagmm_bench.methods.ablations import ABLATIONS
from adagmm_bench.methods.ours import VARIANTS, register
from adagmm_bench.models import find_models
from adagmm_bench.problem import PREPARATIONS, Problem, prepare
from adagmm_bench.replay_log import log_replay, replay_blueprint
from adagmm_bench.simulation import SWEEPS, TrialId
from adagmm_bench.trial import SimulatedProblem, TrialJob, run_trial
from adagmm_fusion.rerun_arguments import add_rerun_arguments
from adagmm_fusion.rerun_log import check_destination, open_stream
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import rotation_error_deg


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dimension", type=int, choices=(2, 3))
    parser.add_argument("sweep", choices=tuple(SWEEPS))
    parser.add_argument("setting", type=float, help="a setting of the sweep, as the tables show it")
    parser.add_argument("trial", type=int, help="0 is the first")
    parser.add_argument("--seed", type=int, default=0, help="default %(default)s")
    parser.add_argument("--rotation-range", type=float, metavar="DEG", help="as it was given to sim2d or sim3d")
    parser.add_argument("--method", default="adagmm", help="default %(default)s")
    parser.add_argument("--start", default="centroids", choices=tuple(PREPARATIONS), help="default %(default)s")
    parser.add_argument("--view", action="store_true", help="open the Rerun viewer")
    add_rerun_arguments(parser)
    add_data(parser)


def run(arguments: argparse.Namespace) -> int:
    check_destination(arguments)
    if arguments.method not in METHODS:
        raise InputError(f"method: unknown {arguments.method!r}; known are {', '.join(METHODS)}")
    if (missing := METHODS[arguments.method].missing()) is not None:
        raise InputError(f"method: {arguments.method} {missing}")
    trial_id = TrialId(
        arguments.dimension,
        arguments.sweep,
        arguments.setting,
        arguments.trial,
        arguments.seed,
        arguments.rotation_range,
    )
    source = SimulatedProblem(trial_id, find_models(arguments.dimension, data_folder(arguments)))
    job = TrialJob(source, arguments.method, arguments.start)
    record = run_trial(job)
    text = json.dumps(record, indent=2)
    print(text)
    if arguments.view or arguments.save or arguments.serve or arguments.connect or arguments.url:
        problem = source.load()
        poses = poses_on_the_way(job, problem, np.array(record["T_target_source"]))
        errors_deg = np.array([rotation_error_deg(problem.T_target_source, T) for T in poses])
        with open_stream(arguments, record["key"], replay_blueprint(arguments.dimension)) as rec:
            log_replay(rec, problem, poses, errors_deg, f"# {record['key']}\n\n```json\n{text}\n```\n")
    return 0


def poses_on_the_way(job: TrialJob, problem: Problem, T_estimate: np.ndarray) -> np.ndarray:
    """(K, D+1, D+1) between the given clouds: every iteration of ours, the start and the estimate of others."""
    prepared = prepare(problem, job.start)
    if job.method in VARIANTS | ABLATIONS:
        steps = register(job.method, prepared.source, prepared.target).transformations
        return np.array([prepared.restore(T) for T in steps])
    return np.array([prepared.restore(np.eye(problem.dimension + 1)), T_estimate])
