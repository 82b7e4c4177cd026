"""The regression behind `details.belief`, and the outcomes that it is fitted to."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_bench.belief.trial import SEEN
from adagmm_fusion.files.input_file import read_input_text
from adagmm_o3d.errors import InputError
from adagmm_o3d.result import Verdict
from adagmm_o3d.trust.verdict import WEIGHTS, signs

# The outcomes that the package's own weights come from.
RECORDED = Path(__file__).with_name("outcomes.json")
# Weights are held towards nothing as if so many trials spoke for that, in units of the signs' spread; Newton's steps.
RIDGE, STEPS = 0.3, 50
# Of weights and the constant.
DIGITS = 1


@dataclass(frozen=True)
class Fitted:
    """weights : (k,), and the constant, of a logistic regression."""

    weights: np.ndarray
    constant: float

    def believes(self, signs: np.ndarray) -> np.ndarray:
        """(n,) whether (n, k) signs speak for a pose more than against it."""
        return signs @ self.weights + self.constant > 0.0

    def rounded(self) -> tuple[tuple[float, ...], float]:
        """As the package has them."""
        return tuple(round(float(weight), DIGITS) for weight in self.weights), round(self.constant, DIGITS)


@dataclass(frozen=True)
class Outcomes:
    """signs : (n, k).   right : (n,) whether the pose was."""

    signs: np.ndarray
    right: np.ndarray

    def __len__(self) -> int:
        return len(self.right)


def outcomes_of(told: Sequence[tuple[Sequence[float] | None, bool]]) -> Outcomes:
    """Of signs and whether the pose is right, those that have signs, of this version."""
    usable = [(signs, right) for signs, right in told if signs is not None and len(signs) == len(WEIGHTS)]
    signs = np.array([signs for signs, _ in usable]).reshape(-1, len(WEIGHTS))
    return Outcomes(signs, np.array([right for _, right in usable], dtype=bool))


def outcomes_seen(outcomes: Sequence[dict]) -> Outcomes:
    """Of what trials have `seen`, and whether the pose is `right`."""
    return outcomes_of([(None if o["seen"] is None else signs_seen(o["seen"]), bool(o["right"])) for o in outcomes])


def signs_seen(seen: Sequence[float]) -> list[float]:
    """The signs of what a trial has seen of a pose, in the order of SEEN."""
    values: dict[str, Any] = dict(zip(SEEN, seen, strict=True))
    return signs(Verdict(0.0, **values)).tolist()


def read_outcomes(path: Path = RECORDED) -> list[dict]:
    """The outcomes of a file that `adagmm-bench belief --record` wrote: `pair`, `seen` and `right` of each.

    Raises
    ------
    InputError  if it is no such file.
    """
    try:
        outcomes = json.loads(read_input_text(path, InputError))["outcomes"]
        return [{name: outcome[name] for name in ("pair", "seen", "right")} for outcome in outcomes]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: expected outcomes, as --record writes them, got {error!r}") from error


def fit_belief(outcomes: Outcomes) -> Fitted:
    """Logistic regression by Newton's method; right and wrong outcomes weigh the same together, however many there are.

    Raises
    ------
    InputError  unless some are right and some wrong.
    """
    signs, right = outcomes.signs, outcomes.right
    if not 0 < right.sum() < len(right):
        raise InputError(f"outcomes: expected some right and some wrong, got {right.sum()} right of {len(right)}")
    centre, spread = signs.mean(axis=0), np.maximum(signs.std(axis=0), 1e-9)
    rows = np.column_stack([np.ones(len(signs)), (signs - centre) / spread])
    shares = np.where(right, 0.5 / right.mean(), 0.5 / (1.0 - right.mean()))
    ridge = RIDGE * np.diag([0.0] + [1.0] * signs.shape[1])
    solution = np.zeros(rows.shape[1])
    for _ in range(STEPS):
        expected = 1.0 / (1.0 + np.exp(-rows @ solution))
        hessian = (rows * (shares * expected * (1.0 - expected))[:, None]).T @ rows + ridge
        solution += np.linalg.solve(hessian, rows.T @ (shares * (right - expected)) - ridge @ solution)
    weights = solution[1:] / spread
    return Fitted(weights, float(solution[0] - weights @ centre))
