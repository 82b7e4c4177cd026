"""The regression behind `details.belief`: fitted on generated pairs, checked on recorded ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adagmm_bench.pairs.made import CASES
from adagmm_bench.pairs.overlap import OVERLAP
from adagmm_bench.pairs.tables import is_found
from adagmm_o3d.trust.verdict import WEIGHTS

# Weights are held towards nothing as if so many trials spoke for that, in units of the signs' spread; Newton's steps.
RIDGE, STEPS = 0.3, 50
# Where another size is the fault the pose itself may agree.
LEFT_OUT = ("scale 1.05",)


@dataclass(frozen=True)
class Fitted:
    """weights : (k,), and the constant, of a logistic regression."""

    weights: np.ndarray
    constant: float

    def believes(self, signs: np.ndarray) -> np.ndarray:
        """(n,) whether (n, k) signs speak for a pose more than against it."""
        return signs @ self.weights + self.constant > 0.0


def has_signs(record: dict) -> bool:
    """Whether a trial has the signs of this version, and the pose is what it is about."""
    signs = record.get("signs") or ()
    return record["status"] == "ok" and len(signs) == len(WEIGHTS) and record["problem"]["group"] not in LEFT_OUT


def is_generated(record: dict) -> bool:
    return record["problem"]["section"] == OVERLAP or record["problem"]["group"] in CASES


def signs_and_truth(records: Sequence[dict]) -> tuple[np.ndarray, np.ndarray]:
    """(n, k) signs and (n,) whether the pose is right."""
    return np.array([record["signs"] for record in records]), np.array([is_found(record) for record in records])


def fit_belief(signs: np.ndarray, right: np.ndarray) -> Fitted:
    """Logistic regression by Newton's method; right and wrong outcomes weigh the same together, however many there are.

    Parameters
    ----------
    signs : (n, k).   right : (n,) bool, some of both.
    """
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
