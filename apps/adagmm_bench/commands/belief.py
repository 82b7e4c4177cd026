"""`belief`: registers generated pairs, fits the regression behind `details.belief` to what came of them, and checks it
on reports of `pairs`, which it is not fitted to."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adagmm_bench.belief.pairs import KINDS, BeliefPair
from adagmm_bench.belief.regression import RECORDED, Fitted, Outcomes, fit_belief, outcomes_of, outcomes_seen
from adagmm_bench.belief.trial import run_belief_trial
from adagmm_bench.commands.options import add_output, add_placement, check_count, open_journal, placement
from adagmm_bench.pairs.tables import is_found
from adagmm_bench.report import command_line, machine_note, markdown_table, print_table, write_json
from adagmm_bench.runner import run_jobs
from adagmm_bench.trial import TrialJob
from adagmm_fusion.files.atomic_file import check_output_file, write_text
from adagmm_fusion.files.input_file import read_input_text
from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.errors import InputError
from adagmm_o3d.trust.verdict import CONSTANT, WEIGHTS

METHOD, START = "adagmm", "as-given"
# The seed and the trials of each kind that the package's weights come from; the pairs of `pairs` are others.
SEED, TRIALS = 1, 30
COLUMNS = ["weights", "of", "pairs", "right", "wrong, believed", "right, not believed"]
# Where another size is the fault the pose itself may agree.
LEFT_OUT = ("scale 1.05",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "reports", type=Path, nargs="*", help="report.json of `adagmm-bench pairs`, to check the weights on"
    )
    parser.add_argument("--trials", type=int, default=TRIALS, help="of each kind of pair (default %(default)s)")
    parser.add_argument("--seed", type=int, default=SEED, help="of the pairs (default %(default)s)")
    parser.add_argument("--record", action="store_true", help="write the outcomes where the package's own are kept")
    add_placement(parser)
    add_output(parser, "belief")


def run(arguments: argparse.Namespace) -> int:
    check_count("trials", arguments.trials)
    if arguments.seed < 0:
        raise InputError(f"seed: expected 0 or more, got {arguments.seed}")
    if arguments.record:
        check_output_file(RECORDED)
    held_out = [record for path in arguments.reports for record in read_trials(path)]
    jobs = [
        TrialJob(BeliefPair(kind, trial, arguments.seed), METHOD, START)
        for kind in KINDS
        for trial in range(arguments.trials)
    ]
    with open_journal(arguments) as journal:
        records = run_jobs(jobs, journal, placement(arguments), run=run_belief_trial)
    outcomes = [
        {"pair": job.problem.key, "seen": record.get("seen"), "right": bool(record.get("right"))}
        for job, record in zip(jobs, records, strict=True)
    ]
    generated = outcomes_seen(outcomes)
    fitted = fit_belief(generated)
    weights, constant = fitted.rounded()
    print("fitted:", *weights, f"constant {constant}")
    print("the package's:", *WEIGHTS, f"constant {CONSTANT}")
    groups = {"generated": generated}
    if held_out:
        groups["held out"] = outcomes_of([(record.get("signs"), is_found(record)) for record in held_out])
    rows = []
    for name, weighed in (("fitted", fitted), ("the package's", Fitted(np.array(WEIGHTS), CONSTANT))):
        rows += [_checked(name, group, members, weighed) for group, members in groups.items() if len(members)]
    print_table("belief alone, other warnings left aside", COLUMNS, rows)
    head = {"command": command_line(), "machine": machine_note(), "weights": weights, "constant": constant}
    text = (
        f"# Belief\n\n`{command_line()}`\n\nweights {weights}, constant {constant}\n\n{markdown_table(COLUMNS, rows)}"
    )
    write_text(arguments.output / "report.md", text)
    write_json(arguments.output / "report.json", head | {"outcomes": outcomes})
    if arguments.record:
        kept = [outcome | {"seen": _short(outcome["seen"])} for outcome in outcomes]
        told = {"machine": machine_note(), "seed": arguments.seed, "trials": arguments.trials}
        write_json(RECORDED, told | {"outcomes": kept})
        print(printable(f"recorded in {RECORDED}"))
    return 0


def read_trials(path: Path) -> list[dict]:
    """The trials of a report of `pairs` that say whether the pose is right.

    Raises
    ------
    InputError  if the file is no such report.
    """
    text = read_input_text(path, InputError)
    try:
        trials = json.loads(text)["trials"]
        known = all({"status", "problem", "limits"} <= set(trial) for trial in trials)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: expected a report.json of adagmm-bench pairs, got {error}") from error
    if not known:
        raise InputError(f"{path}: expected trials of adagmm-bench pairs, got others")
    return [trial for trial in trials if trial["problem"]["group"] not in LEFT_OUT]


def _checked(name: str, group: str, members: Outcomes, weighed: Fitted) -> list:
    believed, right = weighed.believes(members.signs), members.right
    return [name, group, len(members), right.sum(), (believed & ~right).sum(), (right & ~believed).sum()]


def _short(seen: Sequence[float] | None) -> list[float] | None:
    """In as many digits as matter."""
    return None if seen is None else [round(value, 4) for value in seen]
