"""`belief`: fits the regression behind `details.belief` to outcomes of `pairs`, and checks it on the held-out ones."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from adagmm_bench.pairs.belief import Fitted, fit_belief, has_signs, is_generated, signs_and_truth
from adagmm_bench.report import print_table
from adagmm_o3d.errors import InputError
from adagmm_o3d.trust.verdict import CONSTANT, WEIGHTS

COLUMNS = ["weights", "of", "pairs", "right", "wrong, believed", "right, not believed"]
FITTED, HELD_OUT = "generated", "held out"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "reports", type=Path, nargs="+", help="report.json of `adagmm-bench pairs --only overlap,trust`, one or more"
    )


def run(arguments: argparse.Namespace) -> int:
    records = [record for path in arguments.reports for record in read_trials(path) if has_signs(record)]
    groups = {
        FITTED: [record for record in records if is_generated(record)],
        HELD_OUT: [record for record in records if not is_generated(record)],
    }
    signs, right = (
        signs_and_truth(groups[FITTED]) if groups[FITTED] else (np.empty((0, len(WEIGHTS))), np.empty(0, bool))
    )
    if not 0 < right.sum() < len(right):
        raise InputError(
            f"reports: expected generated pairs with right and with wrong outcomes, got {right.sum()} right of "
            f"{len(right)}; run adagmm-bench pairs --only overlap,trust"
        )
    fitted = fit_belief(signs, right)
    print("fitted:", *(f"{weight:.1f}" for weight in fitted.weights), f"constant {fitted.constant:.2f}")
    print("the package's:", *WEIGHTS, f"constant {CONSTANT}")
    rows = []
    for name, weights in (("fitted", fitted), ("the package's", Fitted(np.array(WEIGHTS), CONSTANT))):
        for group, members in groups.items():
            if members:
                signs, right = signs_and_truth(members)
                believed = weights.believes(signs)
                counts = [right.sum(), (believed & ~right).sum(), (right & ~believed).sum()]
                rows.append([name, group, len(members), *counts])
    print_table("belief alone, other warnings left aside", COLUMNS, rows)
    return 0


def read_trials(path: Path) -> list[dict]:
    """The trials of a report of `pairs`.

    Raises
    ------
    InputError  if the file is no such report.
    """
    try:
        trials = json.loads(path.read_text(encoding="utf-8"))["trials"]
        known = all({"status", "problem", "limits"} <= set(trial) for trial in trials)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: expected a report.json of adagmm-bench pairs, got {error}") from error
    if not known:
        raise InputError(f"{path}: expected trials of adagmm-bench pairs, got others")
    return trials
