"""Trials on coloured pairs of frames, and a row for each start and method."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adagmm_bench.color_trial import STARTS, meaning, run_color_trial, version_of
from adagmm_bench.journal import Journal
from adagmm_bench.runner import Placement, run_jobs
from adagmm_bench.scenes import FramePair
from adagmm_bench.trial import TrialJob
from adagmm_fusion.pairs.settings import Settings

COLUMNS = ["start, method", "found", "median of all: rotation [°]", "translation [mm]", "CPU s, median"]


def run_color_trials(
    pairs: Sequence[FramePair], names: Sequence[str], journal: Journal, placement: Placement
) -> list[dict]:
    """The records of every method on every pair from every start."""
    jobs = [TrialJob(pair, name, start) for pair in pairs for start in STARTS for name in names]
    return run_jobs(jobs, journal, placement, run=run_color_trial, version_of=version_of)


def color_rows(records: list[dict], names: Sequence[str]) -> list[list[str]]:
    """A row for each start and method."""
    limits, rows = Settings(), []
    for start in STARTS:
        for name in names:
            own = [record for record in records if (record["start"], record["method"]) == (start, name)]
            degrees = np.array([record["rotation_error_deg"] for record in own])
            millimetres = 1000.0 * np.array([record["translation_error"] for record in own])
            found = (degrees <= limits.max_rotation_error_deg) & (millimetres <= limits.max_translation_error_mm)
            seconds = np.median([record["cpu_seconds"] for record in own])
            medians = f"{np.median(degrees):.2f}", f"{np.median(millimetres):.1f}", f"{seconds:.2f}"
            rows.append([f"{start}, {name}", f"{found.sum()}/{len(own)}", *medians])
    return rows


def color_text() -> str:
    """What the rows are of."""
    limits = Settings()
    return (
        "The truth, turned about the target's centroid and shifted as said, is the start. Found: within "
        f"{limits.max_rotation_error_deg:g}° and {limits.max_translation_error_mm:g} mm."
    )


def color_methods(names: Sequence[str]) -> str:
    """A line for each method."""
    return "".join(f"- `{name}`: {meaning(name)}\n" for name in names)
