"""What a speed section hands back, and the clocks it uses."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from adagmm_bench.methods import METHODS
from adagmm_bench.problem import Problem, prepare


@dataclass(frozen=True)
class Measurement:
    """One line of the speed table.

    cost : True for a ratio to something measured in the same run, smaller is better: those are compared with the
        recorded ones, because seconds do not carry over from machine to machine.
    goal : what `value` should not exceed, where the project has set itself a goal.
    """

    section: str
    name: str
    value: float
    unit: str
    cost: bool = False
    goal: float | None = None

    @property
    def key(self) -> str:
        return f"{self.section}: {self.name}"


def interleaved_seconds(
    methods: Sequence[str], problems: Sequence[Problem], start: str, repeats: int
) -> dict[str, np.ndarray]:
    """(repeats, problems) CPU seconds of each method. The methods take turns on each problem, in every repeat, so that
    whatever else the machine does meets them alike.
    """
    prepared = [prepare(problem, start) for problem in problems]
    seconds = {name: np.zeros((repeats, len(problems))) for name in methods}
    for name in methods:  # imports and compilation
        cpu_seconds(lambda name=name: METHODS[name](prepared[0].source, prepared[0].target))
    for repeat in range(repeats):
        for i, pair in enumerate(prepared):
            for name in methods:
                seconds[name][repeat, i] = cpu_seconds(
                    lambda name=name, pair=pair: METHODS[name](pair.source, pair.target)
                )
    return seconds


def best_seconds(runs: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """The shortest of some runs of each, taking turns: what the machine can do when nothing disturbs it."""
    for run in runs.values():
        run()
    seconds = [{name: cpu_seconds(run) for name, run in runs.items()} for _ in range(repeats)]
    return {name: min(round[name] for round in seconds) for name in runs}


def cpu_seconds(function: Callable[[], object]) -> float:
    """CPU seconds of all threads: on an idle core the time on the clock, on a busy one still the work."""
    started = time.process_time()
    function()
    return time.process_time() - started
