"""`recordings`: RGB-D recordings with ground truth, end to end through the app, and others on the same clouds."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping, Sequence

import numpy as np

from adagmm_bench.commands.options import (
    add_methods,
    add_trials,
    chosen_methods,
    chosen_starts,
    open_journal,
    placement,
    trial_jobs,
    usable_frame_pairs,
)
from adagmm_bench.methods import METHODS
from adagmm_bench.mounting import errors_up_to_mounting
from adagmm_bench.pair_report import pair_table, write_pair_report
from adagmm_bench.report import markdown_table, print_table
from adagmm_bench.runner import run_jobs
from adagmm_bench.scenes import RECORDING_PARTNER_DISTANCE, FramePair
from adagmm_bench.summary import summarise
from adagmm_bench.trial import TrialJob, judge, record_of, run_trial
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.processes.terminal import printable
from adagmm_fusion.source_digest import source_digest

END_TO_END = "adagmm-fusion"
METHODS_BESIDE = ("adagmm", "open3d-point-to-plane", "open3d-gicp", "open3d-gicp-covariances", "small-gicp")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_methods(parser)
    parser.set_defaults(methods=METHODS_BESIDE, starts=("as-given", "centroids"))
    add_trials(parser, "recordings")


def run(arguments: argparse.Namespace) -> int:
    pairs, unusable = usable_frame_pairs(arguments)
    methods, skipped = chosen_methods(arguments, 3)
    starts = chosen_starts(arguments)
    jobs = [TrialJob(pair, END_TO_END, "as-given") for pair in pairs]
    # Pair by pair, so that a worker makes its clouds once.
    jobs += [job for pair in pairs for job in trial_jobs([pair], methods, starts)]
    with open_journal(arguments) as journal:
        records = run_jobs(jobs, journal, placement(arguments), run=run_frame_trial, version_of=version_of)
    limits = Settings()

    def found(record: Mapping) -> bool:
        within_translation = 1000 * record["translation_error"] <= limits.max_translation_error_mm
        return record["rotation_error_deg"] <= limits.max_rotation_error_deg and within_translation

    body = (
        f"Found: rotation within {limits.max_rotation_error_deg:g}° and translation within "
        f"{limits.max_translation_error_mm:g} mm of the recording's ground truth. {END_TO_END} is the whole app from "
        "the frames on, with the time of making the clouds; the others get its clouds. Overlap: share of source points "
        f"with a target point within {1000 * RECORDING_PARTNER_DISTANCE:g} mm.\n\n"
    )
    for name in dict.fromkeys(record["problem"]["recording"] for record in records):
        own = [record for record in records if record["problem"]["recording"] == name]
        summaries = summarise(own, found)
        columns, rows = pair_table(summaries, own)
        body += f"## {name}\n\n{markdown_table(columns, rows)}\n"
        print_table(f"{name}, {summaries[0].trials} pairs", columns, rows)
        if mounted := mounting_line([record for record in own if record["method"] == END_TO_END and found(record)]):
            body += f"{mounted}\n\n"
            print(printable(mounted))
    if unusable:
        body += "Recordings left out:\n\n" + "".join(f"- {line}\n" for line in unusable)
    title = "RGB-D recordings with ground truth"
    write_pair_report(arguments.output, title, body, records, summarise(records, found), skipped)
    print(printable(f"report and every trial: {arguments.output}"))
    return 0


def mounting_line(records: Sequence[Mapping]) -> str:
    """What is left of the app's errors when the truth may be turned on its mount; empty where that cannot be said."""
    truths, estimates = (
        np.array([record[key] for record in records], dtype=float).reshape(-1, 4, 4)[:, :3, :3]
        for key in ("T_target_source_truth", "T_target_source")
    )
    left = errors_up_to_mounting(truths, estimates)
    if left is None:
        return ""
    before = np.median([record["rotation_error_deg"] for record in records])
    after = np.median(left.rotation_error_deg)
    return (
        f"{END_TO_END}, {len(records)} found: median rotation error {before:.2f}°; {after:.2f}° up to one turn of the "
        f"camera on what the truth is of ({left.turn_deg:.1f}°), each pair by that of the others."
    )


def version_of(method_name: str) -> str:
    if method_name != END_TO_END:
        return METHODS[method_name].version()
    return f"{METHODS['adagmm'].version()} in adagmm-fusion ({source_digest('adagmm_fusion')})"


def run_frame_trial(job: TrialJob) -> dict:
    """A method on the app's clouds, or, under the name of the app, its own pipeline from the frames on."""
    if job.method != END_TO_END:
        return run_trial(job)
    assert isinstance(job.problem, FramePair)
    pair = job.problem.frames()
    started, started_cpu = time.perf_counter(), time.process_time()
    outcome = register_pair(pair, Settings())
    seconds, cpu_seconds = time.perf_counter() - started, time.process_time() - started_cpu
    if outcome.T_estimate is None:
        status, T = "failed", np.eye(4)
    else:
        status, T = "ok", np.asarray(outcome.T_estimate)
    return record_of(
        job,
        version_of(job.method),
        status=status,
        reason=outcome.reason,
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        T_target_source_truth=np.asarray(pair.T_target_source).tolist(),
        **judge(job.problem.load(), T, job.problem.partner_distance),
    )
