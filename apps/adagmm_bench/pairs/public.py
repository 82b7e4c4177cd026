"""Public pairs of clouds, `cloud_pairs/*.npz`: fragments of rooms, range scans, LiDAR, a part in its model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from adagmm_bench.archives import numbers, read_archive
from adagmm_bench.pairs.problem import PairClouds, plain_pair
from adagmm_fusion.files.input_file import input_digest
from adagmm_o3d.errors import InputError

CLOUDS = "clouds"
ARRAYS = ("source", "target", "T")
MIN_POINTS = 10


@dataclass(frozen=True)
class PublicPair:
    """One file: `source` (M, 3), `target` (N, 3), and `T` (4, 4), source to target; of NaN where nobody measured it."""

    path: Path

    @property
    def key(self) -> str:
        return f"cloud pair {self.path.stem}"

    def content(self) -> str:
        return input_digest(self.path, InputError)

    def facts(self) -> dict:
        return {"section": CLOUDS, "group": CLOUDS, "pair": self.path.stem}

    def load(self) -> PairClouds:
        return _load(self)


@lru_cache(maxsize=1)
def _load(pair: PublicPair) -> PairClouds:
    """The clouds, whole, for everybody; the unit is the larger RMS radius.

    Raises
    ------
    InputError  if the file cannot be read, lacks an array or holds something else.
    """
    arrays = read_archive(pair.path, f"a pair of {', '.join(ARRAYS)}", ARRAYS)
    source, target, T = (numbers(pair.path, name, arrays[name]) for name in ARRAYS)
    for name, points in (("source", source), ("target", target)):
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < MIN_POINTS or not np.isfinite(points).all():
            raise InputError(
                f"{pair.path}: {name}: expected at least {MIN_POINTS} finite points, (n, 3), got {points.shape}"
            )
    if T.shape != (4, 4) or not (np.isfinite(T).all() or np.isnan(T).all()):
        unknown = np.count_nonzero(~np.isfinite(T))
        raise InputError(
            f"{pair.path}: T: expected a finite (4, 4) pose, or NaN throughout, got {T.shape}, {unknown} not finite"
        )
    return plain_pair(source, target, T if np.isfinite(T).all() else None)


def find_public_pairs(data_folder: Path | None) -> list[PublicPair]:
    """The pairs of a data folder in order.

    Raises
    ------
    InputError  if there is none.
    """
    folder = None if data_folder is None else data_folder / "cloud_pairs"
    paths = [] if folder is None else sorted(folder.glob("*.npz"))
    if not paths:
        where = folder or "no data folder"
        raise InputError(f"data: expected cloud_pairs/*.npz files, found none ({where}); name the folder by --data")
    return [PublicPair(path) for path in paths]
