"""Pieces of one model or room that share less and less: two parallel planes cut off what each lacks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from adagmm_bench.models import find_models, load_models, models_digest
from adagmm_bench.pairs.motions import about, moved, rigid, turn
from adagmm_bench.pairs.problem import FOUND_DEG, PairClouds, cloud_of_points, plain_pair, rms_radius
from adagmm_bench.pairs.public import PublicPair, find_public_pairs
from adagmm_o3d import lie
from adagmm_o3d.errors import InputError

OVERLAP = "overlap"
SHARES = (0.6, 0.5, 0.4, 0.3, 0.2)  # of the smaller piece's points, that the other has too
MODELS, ROOMS = "models", "rooms"
NEAR, ANYWHERE = "start within 20°", "any start"
NEAR_DEG, NEAR_SHIFT = 20.0, 0.1  # degrees, RMS radii
NOISE = 0.005  # radii, in models; rooms are sampled anew
ROOM_GRID = 0.03  # m
ROOM_FOUND = (FOUND_DEG, 0.2)  # degrees, m
# Files of cloud_pairs that hold two fragments of a room each, three rooms.
ROOM_FILES = ("3dm_7-scenes-redki_0_5", "3dm_sun3d-hotel_um_8_15", "o3d_frag_0_4")


@dataclass(frozen=True)
class OverlapPair:
    """A trial: the piece, the planes and the motion depend on seed and number alone, so that the trials of one number
    differ in what is shared only.
    """

    kind: str
    share: float
    start: str
    trial: int
    seed: int
    models_path: Path | None = None
    rooms: tuple[Path, ...] = ()

    @property
    def key(self) -> str:
        models = self.models_path.name if self.models_path else "made shapes"
        origin = models if self.kind == MODELS else f"a grid of {ROOM_GRID:g} m"
        return f"{self.kind} share {self.share:g} {self.start} #{self.trial} seed {self.seed} on {origin}"

    def content(self) -> str:
        if self.kind == MODELS:
            return models_digest(self.models_path)
        return " ".join(PublicPair(path).content() for path in self.rooms)

    def facts(self) -> dict:
        return {
            "section": OVERLAP,
            "group": f"{self.kind}, {self.start}",
            "pair": f"{self.share:g} #{self.trial}",
            "share": self.share,
        }

    def load(self) -> PairClouds:
        return _load(self)


@lru_cache(maxsize=1)
def _load(pair: OverlapPair) -> PairClouds:
    rng = np.random.default_rng([pair.seed, (MODELS, ROOMS).index(pair.kind), pair.trial])
    if pair.kind == MODELS:
        models = whole_models(pair.models_path)
        whole = models[rng.integers(len(models))]
    else:
        whole = fragment(pair.rooms[rng.integers(len(pair.rooms))], rng.integers(2) == 1)
    radius = rms_radius(whole)
    direction = rng.standard_normal(3)
    near = near_motion(rng, radius)
    anywhere = rigid(turn(rng, None), radius * rng.standard_normal(3))
    motion = about(whole.mean(axis=0), near if pair.start == NEAR else anywhere)
    limits = {}
    if pair.kind == MODELS:
        source, target = (
            piece + rng.normal(0.0, NOISE, piece.shape) for piece in cut(whole, whole, direction, pair.share)
        )
    else:
        half = rng.random(len(whole)) < 0.5
        source, target = (
            np.asarray(cloud_of_points(piece).voxel_down_sample(ROOM_GRID).points)
            for piece in cut(whole[half], whole[~half], direction, pair.share)
        )
        limits = {"limits": ROOM_FOUND}
    return plain_pair(moved(source, motion), target, lie.se_inverse(motion), unit=1.0, **limits)


def near_motion(rng: np.random.Generator, radius: float) -> np.ndarray:
    """(4, 4): a turn by at most NEAR_DEG, and a shift by about NEAR_SHIFT radii."""
    return rigid(turn(rng, rng.uniform(0.0, NEAR_DEG)), NEAR_SHIFT * radius * rng.standard_normal(3) / np.sqrt(3.0))


def cut(one: np.ndarray, other: np.ndarray, direction: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """The lower piece of one sample of a shape, (M, 3), and the upper piece of another, along a direction.

    Each keeps 1 / (2 − share) of the points, so that `share` of either lies between the two planes.
    """
    kept = 1.0 / (2.0 - share)
    along = np.concatenate([one, other]) @ direction
    upper, lower = np.quantile(along, (kept, 1.0 - kept))
    return one[one @ direction <= upper], other[other @ direction >= lower]


@lru_cache(maxsize=1)
def whole_models(path: Path | None) -> list[np.ndarray]:
    """The models that were sampled all around, or made shapes for None, of unit RMS radius about the origin."""
    models = load_models(3, path).models
    chosen = [points for name, points in models.items() if name.endswith("_full") or path is None]
    if not chosen:
        raise InputError(f"{path}: expected models named *_full, sampled all around, found none")
    centred = [points - points.mean(axis=0) for points in chosen]
    return [points / rms_radius(points) for points in centred]


@lru_cache(maxsize=1)
def fragment(path: Path, source: bool) -> np.ndarray:
    """The source or the target of a public pair, (N, 3) [m]."""
    clouds = PublicPair(path).load()
    return np.array((clouds.source if source else clouds.target).points)


def find_rooms(data_folder: Path | None) -> list[Path]:
    """The files of ROOM_FILES that a data folder has.

    Raises
    ------
    InputError  if there is none.
    """
    found = {pair.path.stem: pair.path for pair in find_public_pairs(data_folder)}
    rooms = [found[name] for name in ROOM_FILES if name in found]
    if not rooms:
        raise InputError(f"data: expected rooms in cloud_pairs, {', '.join(ROOM_FILES)}; found none of them")
    return rooms


def find_overlap_pairs(data_folder: Path | None, *, trials: int, seed: int) -> tuple[list[OverlapPair], list[str]]:
    """All trials, on made shapes where there are no models, and why rooms are left out."""
    models, skipped = find_models(3, data_folder), []
    kinds: dict[str, dict] = {MODELS: {"models_path": models}}
    try:
        kinds[ROOMS] = {"rooms": tuple(find_rooms(data_folder))}
    except InputError as error:
        skipped.append(f"{OVERLAP} of rooms: {error}")
    pairs = [
        OverlapPair(kind, share, start, trial, seed, **where)
        for kind, where in kinds.items()
        for start in (NEAR, ANYWHERE)
        for share in SHARES
        for trial in range(trials)
    ]
    return pairs, skipped
