"""The schedule of the search, as a value: what each level looks at, how EM runs there, and what goes on to the next.

Lengths are in radii of the clouds, σ in squared radii. All of it was measured; `adagmm-bench ablation` undoes one
choice at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

from adagmm_o3d.mixtures.condensing import SIGMA_FLOOR

# How far two starts may be apart and still lead to the same end: σ = 0.3 does not tell them apart.
SAME_START = 0.1


@dataclass(frozen=True)
class Level:
    """One level.

    size : components of either mixture, in 2D and in 3D.   merged : whether each stands for many points; otherwise they
    are a sample of the points.   floor : least σ.   least_unmatched : least share of points without a partner.
    relative_rmse : when a step is short, see `options.Criteria`.   fastest : the share of itself to which σ may fall in
    an iteration.   iterations : at most.   follow : 1 keeps σ from falling below what the residuals say, 0 lets it fall
    whatever they say.   sigma : where a start begins that brings none.   kept : ends that go on.   apart : how far
    their poses have to be from each other, see `runs.pose_distance`.
    """

    size: tuple[int, int]
    merged: bool
    floor: float
    least_unmatched: float
    relative_rmse: float
    fastest: float
    iterations: int
    follow: float
    sigma: float | None
    kept: int
    apart: float


@dataclass(frozen=True)
class Schedule:
    """The levels of the search, and when it is needed.

    sketch : many starts tried around a doubtful first end.   merged : the first end, and the best of the sketch.
    ranking : those again, on points.   deciding : the ends that are compared.
    grid, grid_merged, grid_ranking, grid_deciding : the same way for a grid of all rotations.
    proposed : poses that features propose; `kept` of these at a time, `apart` from each other.   proposed_deciding :
        their ends, those that have become one once.   near : starts at a pose that the caller gave.
    in_place : a sensor turned without being moved.
    small : clouds of up to so many points decide with all of them; a search among these decides on `small_deciding`:
        on a part it does better (heavy noise above all).
    tight, tight_unmatched : residuals within `tight` of the spacing of the points are no coincidence where at most
        `tight_unmatched` of them have no partner: no search is needed. A smaller part of the points fits as tightly
        in many poses.
    """

    # size, merged, floor, least_unmatched, relative_rmse, fastest, iterations, follow, sigma, kept, apart
    sketch: Level = Level((24, 64), True, 2e-3, 0.05, 5e-4, 0.6, 4, 0.0, None, 8, 0.12)
    merged: Level = Level((200, 200), True, 2e-3, 0.05, 5e-4, 0.65, 4, 0.0, 4e-3, 4, 0.12)
    ranking: Level = Level((400, 400), False, 1e-3, 0.05, 1e-3, 0.65, 6, 0.0, 4e-3, 2, 0.04)
    deciding: Level = Level((1000, 500), False, SIGMA_FLOOR, 0.15, 4e-4, 0.75, 20, 1.0, None, 4, 0.02)
    grid: Level = Level((64, 64), True, 1e-2, 0.05, 1e-4, 0.6, 5, 0.0, 0.1, 32, 0.15)
    grid_merged: Level = Level((150, 150), True, 2e-3, 0.05, 5e-4, 0.65, 6, 0.0, 0.015, 8, 0.1)
    grid_ranking: Level = Level((500, 500), False, 1e-3, 0.05, 1e-3, 0.65, 6, 0.0, 4e-3, 3, 0.05)
    grid_deciding: Level = Level((1000, 1000), False, SIGMA_FLOOR, 0.15, 4e-4, 0.5, 6, 1.0, None, 4, 0.0)
    proposed: Level = Level((500, 500), False, 1e-4, 0.05, 1e-3, 0.8, 6, 0.0, 6e-4, 6, 0.08)
    proposed_deciding: Level = Level((1000, 1000), False, 1e-4, 0.05, 1e-4, 0.8, 8, 0.0, None, 0, 0.02)
    near: Level = Level((500, 500), False, 1e-4, 0.05, 1e-4, 0.77, 20, 0.0, None, 3, 0.0)
    in_place: Level = Level((400, 400), False, 1e-3, 0.05, 1e-3, 0.65, 6, 0.0, 8e-3, 6, 0.1)
    small: int = 1100
    small_deciding: int = 500
    tight: float = 0.5
    tight_unmatched: float = 0.25


SCHEDULE = Schedule()
