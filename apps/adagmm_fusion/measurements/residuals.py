"""Residuals of measurements at a pose, and what they say of it: weights, normal equations, evidence.

Errors of depth cameras are alike where they see the same surface. So no sum over thousands of pixels is as certain as
their number says: for the information, scores are added up over blocks of space, and the variance of these sums takes
the place of that of independent points; for the evidence, what lies in one cell counts once.

Source
------
K.-Y. Liang and S. L. Zeger: Longitudinal data analysis using generalized linear models, Biometrika 73, 1986.   Weights:
K. Lange, R. Little, J. Taylor: Robust statistical modeling using the t distribution, JASA 84, 1989.
"""

from dataclasses import dataclass

import numpy as np

from adagmm_fusion.measurements.depth_errors import DEPTH_ERRORS

# Residuals have the tails of a t distribution of so many degrees of freedom, cut where the square is this large.
FREEDOM, CUT_SQ = 4.0, 25.0
# Medians of chi squared by degrees of freedom.
CHI_SQ_MEDIAN = {1: 0.455, 2: 1.386}
# Edges of the blocks in which errors go together, and of the cells that count once [m].
BLOCK_M, CELL_M = 0.25, 0.1
# Fewer residuals than that say nothing.
LEAST = 6


@dataclass(frozen=True, eq=False)
class Residuals:
    """values (n, k) in standard deviations, their derivatives (n, k, 6) by δ = (ω, v) in exp(δ)·T, those (n, k, 4) by
    what all depths of a camera share, see `depth_errors`, and the places (n, 3) [m] of the measurements."""

    values: np.ndarray
    jacobians: np.ndarray
    by_depth: np.ndarray
    places: np.ndarray

    def take(self, chosen: np.ndarray) -> "Residuals":
        """Those at an index or mask."""
        return Residuals(self.values[chosen], self.jacobians[chosen], self.by_depth[chosen], self.places[chosen])


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """hessian (6, 6) and gradient (6,) of half the weighted sum of squares; cross (6, 4) by the pose and what depths
    share.

    scale : variance of the residuals, over what was said of them.   count : how many have any weight.
    correlation : how many times the variance of the scores is that of independent residuals, ≥ 1.
    """

    hessian: np.ndarray
    gradient: np.ndarray
    cross: np.ndarray
    scale: float
    count: int
    correlation: float

    @property
    def information(self) -> np.ndarray:
        """(6, 6) what is known of the pose, with errors going together block by block."""
        return self.hessian / self.correlation

    @property
    def pull(self) -> np.ndarray:
        """(6,) the gradient of the same weight."""
        return self.gradient / self.correlation

    @property
    def depth_pull(self) -> np.ndarray:
        """(6, 4) cross of the same weight."""
        return self.cross / self.correlation


def squares(residuals: Residuals) -> np.ndarray:
    """(n,) squared lengths of the residuals, in variances."""
    return (residuals.values**2).sum(axis=1)


def robust_scale(residuals: Residuals, least: float) -> float:
    """Variance of the residuals by their median, no less than `least`."""
    return max(float(np.median(squares(residuals))) / CHI_SQ_MEDIAN[residuals.values.shape[1]], least)


def normal_equations(residuals: Residuals, least_scale: float) -> NormalEquations | None:
    """The normal equations of all residuals; None of fewer than LEAST."""
    if len(residuals.values) < LEAST:
        return None
    scale = robust_scale(residuals, least_scale)
    relative = squares(residuals) / scale
    weights = np.where(relative < CUT_SQ, 1.0 / (scale * (1.0 + relative / FREEDOM)), 0.0)
    scores = np.einsum("n,nk,nki->ni", weights, residuals.values, residuals.jacobians)
    rows = residuals.jacobians.reshape(-1, 6)
    weighted = (rows * np.repeat(weights, residuals.values.shape[1])[:, None]).T
    hessian, cross = weighted @ rows, weighted @ residuals.by_depth.reshape(-1, DEPTH_ERRORS)
    count = int(np.count_nonzero(weights))
    if count < LEAST:
        return None
    sums = _sums(residuals.places, BLOCK_M, scores)
    values, vectors = np.linalg.eigh(hessian)
    firm = vectors[:, values > 1e-9 * values[-1]] / np.sqrt(values[values > 1e-9 * values[-1]])
    growth = float(np.mean(((sums @ firm) ** 2).sum(axis=0)))
    return NormalEquations(hessian, scores.sum(axis=0), cross, scale, count, max(growth, 1.0))


def counted_once(places: np.ndarray, gains: np.ndarray) -> float:
    """The sum over cells of the mean gain in each."""
    if not len(places):
        return 0.0
    sums = _sums(places, CELL_M, np.column_stack([gains, np.ones(len(gains))]))
    return float((sums[:, 0] / sums[:, 1]).sum())


def _sums(places: np.ndarray, edge: float, values: np.ndarray) -> np.ndarray:
    """(cells, k) sums of the (n, k) values in each cube of that edge."""
    cells = np.floor(places / edge).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    _, cell = np.unique((cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2], return_inverse=True)
    return np.stack([np.bincount(cell.ravel(), weights=column) for column in values.T], axis=1)
