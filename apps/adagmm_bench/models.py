"""The models of the simulations: fish outlines and 3D shapes from a data folder, or shapes made here where there is
none.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from adagmm_bench.archives import numbers, read_archive
from adagmm_fusion.files.input_file import input_digest
from adagmm_o3d.errors import InputError

MODEL_FILES = {2: Path("fish2d", "fish_100.npz"), 3: Path("models3d.npz")}
MADE_SHAPES = 100
MADE_POINTS = {2: 100, 3: 1000}


@dataclass(frozen=True)
class ModelSet:
    """Models of one dimension by name, (n, D) float64 each; `origin` names where they are from."""

    origin: str
    models: Mapping[str, np.ndarray]


def default_data_folder() -> Path | None:
    """The folder of recordings and models: ADAGMM_SHARED_DATA, else ../shared/data beside the working directory or the
    source tree; None where there is none.
    """
    if named := os.environ.get("ADAGMM_SHARED_DATA"):
        return Path(named)
    source_tree = Path(__file__).resolve().parents[2]
    for base in (Path.cwd(), source_tree):
        folder = base.parent / "shared" / "data"
        if folder.is_dir():
            return folder
    return None


def find_models(dimension: int, data_folder: Path | None) -> Path | None:
    """The model file of a data folder; None without a folder or without that file in it: shapes are made instead."""
    if data_folder is None:
        return None
    path = data_folder / MODEL_FILES[dimension]
    return path if path.is_file() else None


@lru_cache(maxsize=4)
def models_digest(path: Path | None) -> str:
    """Twelve digits that change with the file's content. Raises InputError if it cannot be read."""
    return "made shapes" if path is None else input_digest(path, InputError)


@lru_cache(maxsize=4)
def load_models(dimension: int, path: Path | None) -> ModelSet:
    """The models of a file found by `find_models`, or made shapes for None.

    Raises
    ------
    InputError  if the file is absent or is not an archive of (n, D) arrays.
    """
    if path is None:
        maker = make_outline if dimension == 2 else make_blob
        return ModelSet("made shapes", {f"made_{i:02d}": maker(i) for i in range(MADE_SHAPES)})
    arrays = read_archive(path, "an .npz archive of models")
    if "names" in arrays:
        keys = {str(name): f"m{i}" for i, name in enumerate(arrays["names"])}
        if absent := [key for key in keys.values() if key not in arrays]:
            raise InputError(f"{path}: expected an .npz archive of models, got names without an array {absent[0]}")
    else:
        keys = {key: key for key in arrays}
    models = {name: numbers(path, key, arrays[key]) for name, key in keys.items()}
    for name, points in models.items():
        if points.ndim != 2 or points.shape[1] != dimension or len(points) < 10:
            raise InputError(f"{path}: model {name}: expected at least 10 points, (n, {dimension}), got {points.shape}")
    return ModelSet(path.name, models)


def make_outline(index: int) -> np.ndarray:
    """(100, 2): a closed outline without symmetry, a circle whose radius carries eight random harmonics."""
    rng = np.random.default_rng([2, index])
    angles = np.sort(rng.uniform(0.0, 2 * np.pi, MADE_POINTS[2]))
    order = np.arange(1, 9)
    amplitude, phase = rng.normal(0.0, 0.35, 8) / order, rng.uniform(0.0, 2 * np.pi, 8)
    radius = np.exp(np.cos(np.outer(angles, order) + phase) @ amplitude)
    return np.column_stack([1.6 * radius * np.cos(angles), radius * np.sin(angles)])


def make_blob(index: int) -> np.ndarray:
    """(1000, 3): a closed surface without symmetry, a stretched sphere whose radius carries twelve random waves."""
    rng = np.random.default_rng([3, index])
    directions = rng.standard_normal((MADE_POINTS[3], 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    waves = rng.normal(0.0, 2.0, (3, 12))
    radius = np.exp(0.15 * np.cos(directions @ waves + rng.uniform(0.0, 2 * np.pi, 12)).sum(axis=1))
    return directions * radius[:, None] * np.array([1.5, 1.0, 0.7])
