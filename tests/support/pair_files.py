"""Pairs of clouds in files as `adagmm-bench pairs` reads them."""

from pathlib import Path

import numpy as np

from adagmm_bench.models import make_blob
from adagmm_bench.simulation import rotation_matrix


def pose(angle_deg: float, shift: float = 0.0) -> np.ndarray:
    """(4, 4): a turn about z, and a shift along x."""
    T = np.eye(4)
    T[:3, :3], T[0, 3] = rotation_matrix(np.array([0.0, 0.0, angle_deg])), shift
    return T


def write_pair(path: Path, T: np.ndarray, *, known: bool = True) -> None:
    """A made shape sampled twice, 40 radii wide."""
    rng = np.random.default_rng(3)
    model = 40.0 * np.concatenate([make_blob(0), make_blob(0) + rng.normal(0.0, 0.01, (1000, 3))])
    target, source = model[rng.random(len(model)) < 0.9], model[rng.random(len(model)) < 0.9]
    source = (source - T[:3, 3]) @ T[:3, :3]
    truth = T if known else np.full((4, 4), np.nan)
    np.savez(path, source=source.astype(np.float32), target=target.astype(np.float32), T=truth, kind="made")
