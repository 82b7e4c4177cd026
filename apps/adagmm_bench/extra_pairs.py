"""Pairs that the paper's protocol lacks: clouds that lost opposite sides, and dense clouds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from adagmm_bench.models import load_models, models_digest
from adagmm_bench.problem import Cloud, Problem
from adagmm_bench.simulation import TRANSLATION_LIMIT, degrade, rotation_matrix, unit_radius
from adagmm_bench.speed.large import surface_pair
from adagmm_bench.summary import found_in_simulation
from adagmm_bench.trial import SIMULATION_PARTNER_DISTANCE

# The share that a cloud lost on its side, the share of the rest that was sampled, and its noise [radii].
LOST, SAMPLED, NOISE = 0.3, 0.9, 0.005
TURN_DEG = 15.0
FOUND_TRANSLATION = 0.1  # radii: outlines slide along themselves


@dataclass(frozen=True)
class OppositeSides:
    """A model of the simulations, seen twice: the source without one side, the target without the other.

    Four sevenths of the points have a partner, and the centroids lie up to a radius apart.
    """

    dimension: int
    trial: int
    seed: int
    models_path: Path | None
    partner_distance: float = SIMULATION_PARTNER_DISTANCE

    @property
    def key(self) -> str:
        models = self.models_path.name if self.models_path else "made shapes"
        return f"{self.dimension}D opposite sides #{self.trial} seed {self.seed} on {models}"

    def load(self) -> Problem:
        rng = np.random.default_rng([self.seed, self.dimension, self.trial])
        models = load_models(self.dimension, self.models_path).models
        model = unit_radius(models[list(models)[rng.integers(len(models))]])
        direction = rng.standard_normal(self.dimension)
        R = rotation_matrix(rng.uniform(-TURN_DEG, TURN_DEG, 1 if self.dimension == 2 else 3))
        t = rng.uniform(-TRANSLATION_LIMIT, TRANSLATION_LIMIT, self.dimension)
        T = np.eye(self.dimension + 1)
        T[:-1, :-1], T[:-1, -1] = R, t
        source, target = (
            degrade(without_side(model, along), rng, sampling=SAMPLED, noise=NOISE, outliers=0.0, occlusion=0.0)
            for along in (direction, -direction)
        )
        moved = Cloud((source.points - t) @ R, R.T @ source.covariances @ R)
        return Problem(self.key, source=moved, target=target, T_target_source=T)

    def content(self) -> str:
        return models_digest(self.models_path)

    def facts(self) -> dict:
        return {"dimension": self.dimension, "trial": self.trial, "seed": self.seed}


def without_side(points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The points but for the share LOST of them that lies furthest along a direction."""
    along = points @ direction
    return points[along <= np.quantile(along, 1.0 - LOST)]


def found_part(record: Mapping) -> bool:
    """Whether a pair without opposite sides was found: where the translation is right, too."""
    return found_in_simulation(record) and record["translation_error"] <= FOUND_TRANSLATION


@dataclass(frozen=True)
class DenseSurface:
    """Two samples of one surface of so many points, see `surface_pair`."""

    points: int
    partner_distance: float = 0.05  # m, as on the Kinect scenes

    @property
    def key(self) -> str:
        return f"surface of {self.points} points"

    def load(self) -> Problem:
        return surface_pair(self.points)

    def content(self) -> str:
        return "a made surface"

    def facts(self) -> dict:
        return {"points": self.points}
