"""Many starts tried on coarse mixtures; the likelihood of both clouds decides which of them go on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.expectation import MOST_UNMATCHED
from adagmm_o3d.em.m_step import ANY_AXIS
from adagmm_o3d.em.unmatched import COMPARED_SIGMA, world_density
from adagmm_o3d.kernels.cpu import em as kernel
from adagmm_o3d.kernels.cpu.convolved_rows import Hues
from adagmm_o3d.kernels.cpu.ranges import run_in_ranges
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.update import NO_OVERLAP, SETTLED, fresh_memory
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.merging import COARSE_BITS, MergedMixture
from adagmm_o3d.result import Iteration, StopReason, stop_reason

# With fewer pairs than this for each thread, in all iterations, starting it costs more than it brings.
PAIRS_PER_THREAD = 500_000


class Start(NamedTuple):
    """One start: a pose (4, 4), and how EM runs from it.

    fastest : the share of itself to which σ may fall in an iteration.   follow : 1 keeps σ from falling below what the
    residuals say, 0 lets it fall whatever they say. What follows the pose stands as the kernel's columns do.
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
    `options.Criteria`.   accelerated : whether steps are extrapolated. A long step may end in another optimum than the
    one that its start leads to, so not where ends are still compared.   bits : pairs are left out where their weight is
    below 2**-bits of what it would be without a distance between them.   relaxation : lengthens every step.
    axis : (3,) the only one to turn about, zero where any will do.
    """

    floor: float
    least_unmatched: float
    relative_rmse: float
    accelerated: bool = False
    bits: float = COARSE_BITS
    relaxation: float = 1.0
    axis: Array = field(default_factory=ANY_AXIS.copy)


class End(NamedTuple):
    """Where a start has led: the pose, its σ and unmatched share, how well it explains both clouds, the way there.

    log_likelihood : mean over the points, both clouds added [nats], at the end's own σ and unmatched share, but for a
    constant: neither a pose that explains every point badly nor one that explains a part of them well is favoured.
    trail : for each level the number and what is kept of its iterations (n, kernel.HISTORY_COLUMNS).
    state : one of kernels.update.STATES.   determined : whether the pairs determined the last step.
    """

    pose: Array
    sigma: float
    unmatched: float
    log_likelihood: float
    start: Array
    trail: tuple[tuple[int, Array], ...]
    state: int
    determined: bool

    @property
    def settled(self) -> bool:
        """Whether neither pose nor σ moved any more."""
        return self.state == SETTLED

    @property
    def stop_reason(self) -> StopReason:
        """Why EM goes no further, where it may not have any more iterations."""
        if self.state == NO_OVERLAP:
            return StopReason.NO_OVERLAP
        return stop_reason(self.settled, self.determined)

    @property
    def iterations(self) -> tuple[Iteration, ...]:
        """The way there; put together when it is asked for, as most ends of a search are dropped."""
        return tuple(
            Iteration(pose, sigma, energy, matched, level)
            for level, rows in self.trail
            for pose, (sigma, energy, matched) in zip(_poses(rows[:, :12]), rows[:, 12:].tolist(), strict=True)
        )


def run_starts(
    source: MergedMixture,
    target: MergedMixture,
    starts: list[Start],
    *,
    limits: Limits,
    level: int,
    compared_at: float = COMPARED_SIGMA,
    memories: Array | None = None,
    colour: ColourModel | None = None,
) -> list[End]:
    """Run EM from every start; the ends, in the order of the starts.

    `compared_at` is the σ whose density of points without a partner the ends' likelihoods have in common. `memories`,
    see `kernels.update.fresh_memory`, are what a run that goes on from its end keeps of it; `colour` is what is
    believed of the colours that both mixtures have, or None for geometry alone.
    """
    if not starts:
        return []
    poses = np.array([s.pose[:3] for s in starts]).reshape(-1, 12)
    columns = np.array([start[1:] for start in starts], np.float64)
    ends = np.empty((len(starts), kernel.END_COLUMNS))
    history = np.empty((len(starts), max(s.iterations for s in starts), kernel.HISTORY_COLUMNS))
    half, isotropic = 0.5 * source.dimension, source.isotropic and target.isotropic
    hues = None if colour is None else Hues(source.hues(colour, of_source=True), colour.cap)
    sides = source.as_source(isotropic), hues, target.as_target(isotropic, colour)
    world = LOG2_SCALE**half * world_density(source.dimension)
    if colour is not None:
        # The kernels leave out by how much any two points' colours agree.
        world *= colour.expected
    memories = fresh_memory(len(starts)) if memories is None else memories
    run_limits = kernel.RunLimits(
        source.dimension,
        limits.floor,
        limits.least_unmatched,
        MOST_UNMATCHED,
        float(limits.relative_rmse),
        float(limits.relaxation),
        limits.accelerated,
        limits.bits,
        compared_at,
        limits.axis,
        isotropic,
        world,
    )
    runs = poses, columns, memories, ends, history

    def run(first: int, last: int) -> None:
        kernel.run_em(kernel.Runs(*(rows[first:last] for rows in runs)), *sides, run_limits)

    pairs = len(source.points) * len(target.points) * sum(s.iterations for s in starts)
    run_in_ranges(kernel.run_em, run, len(starts), pairs // PAIRS_PER_THREAD)
    moved = _poses(poses)
    return [
        End(
            pose=moved[k],
            sigma=sigma,
            unmatched=unmatched,
            log_likelihood=log_likelihood,
            start=starts[k].pose,
            trail=((level, history[k, : int(iterations)]),),
            state=int(state),
            determined=bool(determined),
        )
        for k, (sigma, unmatched, log_likelihood, iterations, state, determined) in enumerate(ends.tolist())
    ]


def distinct(ends: list[End], count: int, distance: float) -> list[End]:
    """The `count` likeliest ends whose poses differ by more than `distance`, see `pose_distance`."""
    ranked = sorted(ends, key=lambda end: -end.log_likelihood)
    poses = np.array([end.pose for end in ranked])
    free = np.full(len(ranked), True)
    kept: list[End] = []
    for k, end in enumerate(ranked):
        if len(kept) == count:
            break
        if free[k]:
            kept.append(end)
            free &= pose_distance(poses, end.pose) > distance
    return kept


def joined(before: list[End], after: list[End]) -> list[End]:
    """Each end with the way that led to its start put in front."""
    return [end._replace(start=old.start, trail=old.trail + end.trail) for old, end in zip(before, after, strict=True)]


def inverse_of(poses: Array) -> Array:
    """The inverse rigid motions of (..., 4, 4) poses."""
    inverse = np.zeros_like(poses)
    rotations = np.swapaxes(poses[..., :3, :3], -1, -2)
    inverse[..., :3, :3], inverse[..., 3, 3] = rotations, 1.0
    inverse[..., :3, 3] = -(rotations @ poses[..., :3, 3:])[..., 0]
    return inverse


def inverse_end(end: End) -> End:
    """The same end with source and target in each other's place; the shares of partners stay those of its own
    source."""
    trail = []
    for level, rows in end.trail:
        inverted = rows.copy()
        inverted[:, :12] = inverse_of(_poses(rows[:, :12]))[:, :3].reshape(-1, 12)
        trail.append((level, inverted))
    return end._replace(pose=inverse_of(end.pose), start=inverse_of(end.start), trail=tuple(trail))


def pose_distance(a: Array, b: Array) -> Any:
    """‖R_a − R_b‖_F + ‖t_a − t_b‖ of poses (..., 4, 4) between normalised clouds."""
    squares = ((a[..., :3, :] - b[..., :3, :]) ** 2).sum(axis=-2)
    return np.sqrt(squares[..., :3].sum(axis=-1)) + np.sqrt(squares[..., 3])


def _poses(rows: Array) -> Array:
    """(n, 4, 4) of (n, 12)."""
    poses = np.zeros((len(rows), 4, 4))
    poses[:, :3], poses[:, 3, 3] = rows.reshape(-1, 3, 4), 1.0
    return poses
