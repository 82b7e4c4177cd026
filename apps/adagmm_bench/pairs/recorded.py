"""Pairs of frames of the recordings, geometry alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from adagmm_bench.pairs.problem import FOUND_DEG, PairClouds
from adagmm_bench.scenes import find_frame_pairs
from adagmm_fusion.clouds.building import clouds_from_pair, dense_cloud
from adagmm_fusion.recordings.digests import pair_digest
from adagmm_fusion.recordings.opening import open_recording

RECORDINGS = "recordings"
GRID = 0.02  # m, of the clouds that other libraries get
POINTS = 3500  # of those that ours get
FOUND = (FOUND_DEG, 0.2)  # degrees, m


@dataclass(frozen=True)
class RecordedPair:
    """A pair of a recording with a known pose. Both cameras stand at the origins of their clouds' frames."""

    recording: Path
    index: int
    name: str

    @property
    def key(self) -> str:
        return f"{self.recording.name} {self.name}"

    def content(self) -> str:
        return _content(self)

    def facts(self) -> dict:
        return {"section": RECORDINGS, "group": self.recording.name, "pair": self.name, "viewpoints": True}

    def load(self) -> PairClouds:
        return _load(self)


@cache
def _content(recorded: RecordedPair) -> str:
    """Asked for once for each start of the pair, too."""
    return pair_digest(open_recording(recorded.recording)[recorded.index])


@lru_cache(maxsize=1)
def _load(recorded: RecordedPair) -> PairClouds:
    """Made once for the methods that follow each other on it."""
    pair = open_recording(recorded.recording)[recorded.index]
    source, target = clouds_from_pair(pair, target_points=POINTS, sensor_model="surface")
    camera = np.zeros(3)
    return PairClouds(
        source,
        target,
        *(dense_cloud(frame).voxel_down_sample(GRID) for frame in (pair.source, pair.target)),
        unit=1.0,
        T_target_source=pair.T_target_source,
        centre=camera,
        limits=FOUND,
        source_viewpoint=camera,
        target_viewpoint=camera,
    )


@cache
def find_recorded_pairs(data_folder: Path | None) -> tuple[tuple[RecordedPair, ...], tuple[str, ...]]:
    """All pairs with a known pose under `recordings`, and a line for each folder that holds none.

    Raises
    ------
    InputError  if there is none.
    """
    pairs, skipped = find_frame_pairs(data_folder)
    return tuple(RecordedPair(pair.recording, pair.index, pair.name) for pair in pairs), tuple(skipped)
