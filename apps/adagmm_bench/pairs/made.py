"""Made pairs on which a method shows whether it knows: clouds that share nothing, and such as are easily mistaken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from adagmm_bench.models import MADE_SHAPES, find_models, make_blob, models_digest
from adagmm_bench.pairs.motions import moved, rigid, turn
from adagmm_bench.pairs.overlap import NEAR_SHIFT, NOISE, find_rooms, near_motion, whole_models
from adagmm_bench.pairs.problem import PairClouds, PairSource, plain_pair
from adagmm_bench.pairs.public import PublicPair
from adagmm_bench.pairs.recorded import find_recorded_pairs
from adagmm_bench.simulation import unit_radius
from adagmm_o3d import lie
from adagmm_o3d.errors import InputError

TRUST = "trust"
DIFFERENT_ROOMS = "different rooms"
SCALE = 1.05
# A box, and half a sphere on it that alone tells its poses apart; they start about half a turn off.
FLIP_POINTS, FLIP_EXTENT, FLIP_KNOB, FLIP_AT = 800, (2.0, 1.0, 0.4), 0.3, (0.3, 0.2, 0.5)
FLIP_OFF_DEG = 5.0
# Pieces of one room: Open3D's demo fragments are of the red kitchen of 7-Scenes, one of them even the same piece.
ONE_ROOM = {"o3d_frag_0_4": "3dm_7-scenes-redki_0_5"}


@dataclass(frozen=True)
class MadePair:
    """A pair that is made for one of CASES."""

    case: str
    trial: int
    seed: int
    data_folder: Path | None

    @property
    def key(self) -> str:
        return f"{self.case} #{self.trial} seed {self.seed}"

    def content(self) -> str:
        if self.case == DIFFERENT_ROOMS:
            return " ".join(room.content() for room in _two_rooms(_generator(self), self.trial, self.data_folder))
        return models_digest(find_models(3, self.data_folder)) if CASES[self.case] in OF_MODELS else "made points"

    def facts(self) -> dict:
        seen = self.case == DIFFERENT_ROOMS and self.trial % 2 == 0
        return {"section": TRUST, "group": self.case, "pair": f"#{self.trial}", "viewpoints": seen}

    def load(self) -> PairClouds:
        return _make(self)


@lru_cache(maxsize=1)
def _make(pair: MadePair) -> PairClouds:
    """Made once for the methods that follow each other on it."""
    return CASES[pair.case](_generator(pair), pair.trial, pair.data_folder)


def _generator(pair: MadePair) -> np.random.Generator:
    return np.random.default_rng([pair.seed, list(CASES).index(pair.case), pair.trial])


def halves(rng: np.random.Generator, trial: int, data_folder: Path | None) -> PairClouds:
    """What lies on both sides of a plane through a model."""
    model = _model(rng, data_folder)
    along = model @ rng.standard_normal(3)
    lower = along < np.median(along)
    return _strangers(_near(rng, _noisy(rng, model[lower])), _noisy(rng, model[~lower]))


def unrelated_models(rng: np.random.Generator, trial: int, data_folder: Path | None) -> PairClouds:
    models = whole_models(find_models(3, data_folder))
    one, other = rng.choice(len(models), 2, replace=False)
    return _strangers(_near(rng, models[one]), models[other])


def other_scale(rng: np.random.Generator, trial: int, data_folder: Path | None) -> PairClouds:
    model = _model(rng, data_folder)
    return _strangers(_near(rng, _noisy(rng, model)), SCALE * _noisy(rng, model))


def different_rooms(rng: np.random.Generator, trial: int, data_folder: Path | None) -> PairClouds:
    """By turns clouds of frames of two recordings, and fragments of two rooms."""
    first, second = _two_rooms(rng, trial, data_folder)
    source, target = first.load(), second.load()
    return replace(
        source,
        target=target.target,
        peers_target=target.peers_target,
        target_viewpoint=target.target_viewpoint,
        unit=1.0,
        T_target_source=None,
        related=False,
    )


def _two_rooms(rng: np.random.Generator, trial: int, data_folder: Path | None) -> tuple[PairSource, PairSource]:
    pools = room_pools(data_folder)[trial % 2]
    one, other = rng.choice(list(pools), 2, replace=False)
    first, second = (pools[name][rng.integers(len(pools[name]))] for name in (one, other))
    return first, second


def room_pools(data_folder: Path | None) -> tuple[dict[str, list[PairSource]], dict[str, list[PairSource]]]:
    """The pairs of each recording, and those of each room of `cloud_pairs`.

    Raises
    ------
    InputError  if there are not two of each.
    """
    recorded: dict[str, list[PairSource]] = {}
    for pair in find_recorded_pairs(data_folder)[0]:
        recorded.setdefault(pair.recording.name, []).append(pair)
    rooms: dict[str, list[PairSource]] = {}
    for path in find_rooms(data_folder):
        rooms.setdefault(ONE_ROOM.get(path.stem, path.stem), []).append(PublicPair(path))
    for kind, pool in (("recordings", recorded), ("rooms in cloud_pairs", rooms)):
        if len(pool) < 2:
            raise InputError(f"{data_folder}: expected two or more {kind}, to pair different ones, got {len(pool)}")
    return recorded, rooms


def copies_of_few_points(rng: np.random.Generator, trial: int, data_folder: Path | None) -> PairClouds:
    """From 4 points on, by turns from nearby and from anywhere."""
    points = rng.uniform(-1.0, 1.0, (4 + trial, 3))
    motion = near_motion(rng, 1.0) if trial % 2 else rigid(turn(rng, None), rng.standard_normal(3))
    return plain_pair(moved(points, motion), points, lie.se_inverse(motion))


def flipped(rng: np.random.Generator, trial: int, data_folder: Path | None) -> PairClouds:
    """A box with a knob near one end, sampled twice, half a turn from where only the knob is out of place."""
    target, source = (_box_with_knob(rng) for _ in range(2))
    axis = rng.integers(3)
    half_turn = np.diag([1.0 if i == axis else -1.0 for i in range(3)])
    motion = rigid(turn(rng, rng.uniform(0.0, FLIP_OFF_DEG)) @ half_turn, NEAR_SHIFT * rng.standard_normal(3))
    return plain_pair(moved(source, motion), target, lie.se_inverse(motion))


def mirror_image(rng: np.random.Generator, trial: int, data_folder: Path | None) -> PairClouds:
    """A shape without symmetry, and its mirror image."""
    shape = unit_radius(make_blob(int(rng.integers(MADE_SHAPES))))
    target, source = (shape[rng.permutation(len(shape))[: len(shape) // 2]] for _ in range(2))
    return _strangers(_near(rng, _noisy(rng, source)), _noisy(rng, target) * (-1.0, 1.0, 1.0))


CASES: dict[str, Callable[[np.random.Generator, int, Path | None], PairClouds]] = {
    "halves of a model": halves,
    "unrelated models": unrelated_models,
    "scale 1.05": other_scale,
    DIFFERENT_ROOMS: different_rooms,
    "copies of few points": copies_of_few_points,
    "half a turn off": flipped,
    "mirror images": mirror_image,
}
OF_MODELS = (halves, unrelated_models, other_scale)


def _model(rng: np.random.Generator, data_folder: Path | None) -> np.ndarray:
    models = whole_models(find_models(3, data_folder))
    return models[rng.integers(len(models))]


def _noisy(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    return points + rng.normal(0.0, NOISE, points.shape)


def _near(rng: np.random.Generator, points: np.ndarray) -> np.ndarray:
    return moved(points, near_motion(rng, 1.0))


def _strangers(source: np.ndarray, target: np.ndarray) -> PairClouds:
    return plain_pair(source, target, None, related=False)


def _box_with_knob(rng: np.random.Generator) -> np.ndarray:
    """(n, 3): the six faces of a box by their areas, and half a sphere on top, off the middle."""
    extent = np.array(FLIP_EXTENT)
    areas = np.array([extent[1] * extent[2], extent[0] * extent[2], extent[0] * extent[1]])
    axis = rng.choice(3, FLIP_POINTS, p=areas / areas.sum())
    points = rng.uniform(-0.5, 0.5, (FLIP_POINTS, 3)) * extent
    points[np.arange(FLIP_POINTS), axis] = rng.choice([-0.5, 0.5], FLIP_POINTS) * extent[axis]
    share = 2 * np.pi * FLIP_KNOB**2 / (2 * areas.sum())
    directions = rng.standard_normal((round(share * FLIP_POINTS), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions[:, 2] = np.abs(directions[:, 2])
    knob = FLIP_KNOB * directions + np.array(FLIP_AT) * extent
    return _noisy(rng, np.concatenate([points, knob]))
