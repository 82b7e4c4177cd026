"""Many starts tried on coarse mixtures; the likelihood of both clouds decides which of them go on."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .arguments import Array
from .coarse import COARSE_BITS, MergedMixture
from .expectation import MOST_UNMATCHED
from .kernels import search as kernel
from .kernels.compiling import LOG2_SCALE
from .trace import Iteration


@dataclass(frozen=True)
class Start:
    """One start: a pose (4, 4), and how EM runs from it.

    fastest : the share of itself to which σ may fall in an iteration.   follow : 1 keeps σ from falling below what the
    residuals say, 0 lets it fall whatever they say.
    """

    pose: Array
    sigma: float
    unmatched: float
    fastest: float
    iterations: int
    follow: float


@dataclass(frozen=True)
class Limits:
    """How far EM goes on a level.

    floor : least σ.   least_unmatched : least share of points without a partner.   relative_rmse : as in
    `em.Criteria`.   accelerated : whether steps are extrapolated. A long step may end in another optimum than the one
    that its start leads to, so not where ends are still compared.   bits : pairs are left out where their weight is
    below 2**-bits of what it would be without a distance between them.
    """

    floor: float
    least_unmatched: float
    relative_rmse: float
    accelerated: bool = False
    bits: float = COARSE_BITS


@dataclass(frozen=True)
class End:
    """Where a start has led: the pose, its σ and unmatched share, how well it explains both clouds, the way there.

    log_likelihood : mean over the points, both clouds added [nats], at the end's own σ and unmatched share, but for a
    constant: neither a pose that explains every point badly nor one that explains a part of them well is favoured.
    trail : for each level the number and what is kept of its iterations (n, kernel.HISTORY_COLUMNS).
    """

    pose: Array
    sigma: float
    unmatched: float
    log_likelihood: float
    start: Array
    trail: tuple[tuple[int, Array], ...]
    settled: bool

    @property
    def iterations(self) -> tuple[Iteration, ...]:
        """The way there; put together when it is asked for, as most ends of a search are dropped."""
        return tuple(
            Iteration(
                _pose(row[:12]),
                float(row[kernel.HISTORY_SIGMA]),
                float(row[kernel.HISTORY_ENERGY]),
                float(row[kernel.HISTORY_MATCHED]),
                level,
            )
            for level, rows in self.trail
            for row in rows
        )


def run_starts(
    source: MergedMixture,
    target: MergedMixture,
    starts: list[Start],
    *,
    limits: Limits,
    volume: float,
    level: int,
) -> list[End]:
    """Run EM from every start; the ends, in the order of the starts.

    `volume` is that over which points without a partner are spread, see `expectation.OPEN_VOLUME`.
    """
    if not starts:
        return []
    poses = np.array([s.pose[:3].ravel() for s in starts])
    columns = np.array([[s.sigma, s.unmatched, s.fastest, s.iterations, s.follow] for s in starts], np.float64)
    ends = np.empty((len(starts), kernel.END_COLUMNS))
    history = np.empty((len(starts), max(s.iterations for s in starts), kernel.HISTORY_COLUMNS))
    half, isotropic = 0.5 * source.dimension, source.isotropic and target.isotropic
    kernel.search(
        poses,
        columns,
        source.as_source(isotropic),
        target.as_target(isotropic),
        (source.dimension == 2, isotropic),
        (2.0 * math.pi * LOG2_SCALE) ** half / volume,
        (limits.floor, limits.least_unmatched, MOST_UNMATCHED),
        limits.relative_rmse,
        limits.accelerated,
        limits.bits,
        ends,
        history,
    )
    return [
        End(
            pose=_pose(poses[k]),
            sigma=float(ends[k, kernel.END_SIGMA]),
            unmatched=float(ends[k, kernel.END_UNMATCHED]),
            log_likelihood=float(ends[k, kernel.END_LIKELIHOOD]),
            start=starts[k].pose,
            trail=((level, history[k, : int(ends[k, kernel.END_ITERATIONS])]),),
            settled=bool(ends[k, kernel.END_SETTLED]),
        )
        for k in range(len(starts))
    ]


def distinct(ends: list[End], count: int, distance: float) -> list[End]:
    """The `count` likeliest ends whose poses differ by more than `distance`, see `pose_distance`."""
    kept: list[End] = []
    for end in sorted(ends, key=lambda end: -end.log_likelihood):
        if len(kept) == count:
            break
        if all(pose_distance(end.pose, k.pose) > distance for k in kept):
            kept.append(end)
    return kept


def joined(before: list[End], after: list[End]) -> list[End]:
    """Each end with the way that led to its start put in front."""
    return [replace(end, start=old.start, trail=old.trail + end.trail) for old, end in zip(before, after, strict=True)]


def pose_distance(a: Array, b: Array) -> float:
    """‖R_a − R_b‖_F + ‖t_a − t_b‖ of two (4, 4) poses between normalised clouds."""
    return float(np.linalg.norm(a[:3, :3] - b[:3, :3]) + np.linalg.norm(a[:3, 3] - b[:3, 3]))


def _pose(rows: Array) -> Array:
    pose = np.eye(4)
    pose[:3] = rows.reshape(3, 4)
    return pose
