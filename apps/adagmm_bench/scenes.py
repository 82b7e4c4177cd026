"""Pairs with ground truth: the paper's Kinect scenes, and pairs of RGB-D frames through the app's own cloud making."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import open3d as o3d

from adagmm_bench.archives import numbers, read_archive
from adagmm_bench.problem import Cloud, Problem
from adagmm_fusion.clouds.building import clouds_from_pair
from adagmm_fusion.files.input_file import input_digest
from adagmm_fusion.frames.rgbd import RGBDPair
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.recordings.digests import pair_digest
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.errors import AdaGMMError, InputError

KINECT_PARTNER_DISTANCE = RECORDING_PARTNER_DISTANCE = 0.05  # m, a little over the grid of the clouds
SCENE_ARRAYS = (
    "target",
    "source",
    "target_covariances",
    "source_covariances",
    "T_target_source",
    "T_target_source_authors",
    "authors_seconds",
)


@dataclass(frozen=True)
class KinectScene:
    """`scene_XX.npz`: two clouds [m] with covariances, the calibrated pose, and the authors' result."""

    path: Path
    partner_distance: float = KINECT_PARTNER_DISTANCE

    @property
    def key(self) -> str:
        return self.path.stem

    def content(self) -> str:
        return input_digest(self.path, InputError)

    def facts(self) -> dict:
        return {"scene": self.path.stem}

    def arrays(self) -> dict[str, np.ndarray]:
        """The file's arrays as float64.

        Raises
        ------
        InputError  if the file cannot be read or lacks one of SCENE_ARRAYS.
        """
        arrays = read_archive(self.path, f"a scene with {', '.join(SCENE_ARRAYS)}", SCENE_ARRAYS)
        return {name: numbers(self.path, name, array) for name, array in arrays.items()}

    def load(self) -> Problem:
        arrays = self.arrays()
        return Problem(
            self.key,
            source=Cloud(arrays["source"], arrays["source_covariances"]),
            target=Cloud(arrays["target"], arrays["target_covariances"]),
            T_target_source=arrays["T_target_source"],
        )


def find_scenes(data_folder: Path | None) -> list[KinectScene]:
    """The scenes of a data folder in order.

    Raises
    ------
    InputError  if there is no such folder or no scene in it.
    """
    folder = None if data_folder is None else data_folder / "kinect_pairs"
    paths = [] if folder is None else sorted(folder.glob("scene_*.npz"))
    if not paths:
        where = folder or "no data folder"
        raise InputError(
            f"data: expected kinect_pairs/scene_XX.npz files, found none ({where}); name the folder by --data"
        )
    return [KinectScene(path) for path in paths]


@dataclass(frozen=True)
class FramePair:
    """A pair of a recording, as the clouds [m] that `adagmm-fusion` makes of it."""

    recording: Path
    index: int
    name: str
    partner_distance: float

    @property
    def key(self) -> str:
        return f"{self.recording.name} {self.name}"

    def content(self) -> str:
        return pair_digest(self.frames())

    def facts(self) -> dict:
        return {"recording": self.recording.name, "pair": self.name}

    def frames(self) -> RGBDPair:
        return open_recording(self.recording)[self.index]

    def load(self) -> Problem:
        return _problem_of_frames(self)


@lru_cache(maxsize=4)
def _problem_of_frames(frame_pair: FramePair) -> Problem:
    """Made once for the methods that follow each other on it."""
    pair, settings = frame_pair.frames(), Settings()
    source, target = clouds_from_pair(
        pair, target_points=settings.target_points, sensor_model=settings.sensor_model, max_depth=settings.max_depth_m
    )
    return Problem(frame_pair.key, cloud_of(source), cloud_of(target), pair.T_target_source)


def cloud_of(cloud: o3d.geometry.PointCloud) -> Cloud:
    """An Open3D cloud with covariances as arrays."""
    return Cloud(np.asarray(cloud.points), np.asarray(cloud.covariances))


def find_frame_pairs(data_folder: Path | None) -> tuple[list[FramePair], list[str]]:
    """The pairs with ground truth of the recordings in a data folder, and a line for each folder that holds none.

    Raises
    ------
    InputError  if there is no such folder or none of its recordings can be used.
    """
    root = None if data_folder is None else data_folder / "recordings"
    folders = [] if root is None or not root.is_dir() else sorted(path for path in root.iterdir() if path.is_dir())
    pairs, skipped = [], []
    for folder in folders:
        try:
            recording = open_recording(folder)
            known = [i for i in range(len(recording)) if recording[i].T_target_source is not None]
        except AdaGMMError as error:
            skipped.append(" ".join(str(error).split()))
            continue
        if not known:
            skipped.append(f"{folder}: no pair has a ground truth")
        pairs += [FramePair(folder, i, recording.pair_name(i), RECORDING_PARTNER_DISTANCE) for i in known]
    if not pairs:
        where = "; ".join(skipped) or f"{root or 'no data folder'} holds none"
        raise InputError(
            f"data: expected recordings with ground truth, found none ({where}); name the folder by --data"
        )
    return pairs, skipped
