"""Pairs with a truth from starts that mislead, beside the made ones: does a method know when it is wrong?"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import open3d as o3d

from adagmm_bench.pairs.made import CASES, DIFFERENT_ROOMS, TRUST, MadePair, room_pools
from adagmm_bench.pairs.motions import about, rigid, turn, with_moved_source
from adagmm_bench.pairs.problem import PairClouds, PairSource
from adagmm_bench.pairs.public import find_public_pairs
from adagmm_bench.pairs.recorded import find_recorded_pairs
from adagmm_bench.problem import Cloud
from adagmm_bench.scenes import KinectScene, find_scenes
from adagmm_o3d.errors import InputError

HOWS = AS_GIVEN, RANDOM_START, WRONG_START = "as given", "random start", "wrong start"
WRONG_DEG, WRONG_SHIFT = (60.0, 180.0), 0.5  # how far a wrong `init` is from the truth: degrees, and median radii
KINECT_FOUND = (10.0, 0.2)  # degrees, m: these truths are only good to a few degrees


@dataclass(frozen=True)
class KinectPair:
    """A scene of the paper, with the covariances it comes with; the cameras stand at the origins."""

    scene: KinectScene

    @property
    def key(self) -> str:
        return f"kinect {self.scene.key}"

    def content(self) -> str:
        return self.scene.content()

    def facts(self) -> dict:
        return {"section": TRUST, "group": "Kinect scenes", "pair": self.scene.key}

    def load(self) -> PairClouds:
        problem = self.scene.load()
        clouds = _open3d_cloud(problem.source), _open3d_cloud(problem.target)
        return PairClouds(
            *clouds,
            *clouds,
            unit=1.0,
            T_target_source=problem.T_target_source,
            centre=np.zeros(3),
            limits=KINECT_FOUND,
        )


def _open3d_cloud(cloud: Cloud) -> o3d.geometry.PointCloud:
    """The points whose numbers are finite, those that are marked as outliers too."""
    finite = cloud.subset(np.isfinite(cloud.points).all(axis=1) & np.isfinite(cloud.covariances).all(axis=(1, 2)))
    made = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(finite.points))
    made.covariances = o3d.utility.Matrix3dVector(finite.covariances)
    return made


@dataclass(frozen=True)
class Restarted:
    """A pair with a truth: as it is, its source moved anywhere, or ours given a wrong start."""

    pair: PairSource
    how: str
    trial: int
    seed: int

    @property
    def key(self) -> str:
        return f"{self.pair.key}, {self.how} seed {self.seed}"

    def content(self) -> str:
        return self.pair.content()

    def facts(self) -> dict:
        facts = self.pair.facts()
        return facts | {"section": TRUST, "group": f"{facts['group']}, {self.how}", "start": self.how}

    def load(self) -> PairClouds:
        pair = self.pair.load()
        if self.how == AS_GIVEN:
            return pair
        rng = np.random.default_rng([self.seed, (RANDOM_START, WRONG_START).index(self.how), self.trial])
        source = np.asarray(pair.source.points)
        centre = np.median(source, axis=0)  # Kinect scenes have points far away
        radius = float(np.median(np.linalg.norm(source - centre, axis=1)))
        if self.how == RANDOM_START:
            return with_moved_source(pair, about(centre, rigid(turn(rng, None), radius * rng.standard_normal(3))))
        off = rigid(turn(rng, rng.uniform(*WRONG_DEG)), WRONG_SHIFT * radius * rng.standard_normal(3))
        return replace(pair, init=pair.T_target_source @ about(centre, off))


def find_trust_pairs(data_folder: Path | None, *, trials: int, seed: int) -> tuple[list[PairSource], list[str]]:
    """Made pairs, and every recorded, public or Kinect pair with a truth from misleading starts; and why some are left
    out.
    """
    skipped, cases = [], dict.fromkeys(CASES)
    try:
        room_pools(data_folder)
    except InputError as error:
        skipped.append(f"{TRUST} of {DIFFERENT_ROOMS}: {error}")
        del cases[DIFFERENT_ROOMS]
    pairs: list[PairSource] = [MadePair(case, trial, seed, data_folder) for case in cases for trial in range(trials)]
    known: dict[str, tuple[Callable[[], Sequence[PairSource]], tuple[str, ...]]] = {
        "recordings": (lambda: find_recorded_pairs(data_folder)[0], HOWS),
        "public pairs": (
            lambda: [pair for pair in find_public_pairs(data_folder) if pair.load().T_target_source is not None],
            HOWS,
        ),
        "Kinect scenes": (lambda: [KinectPair(scene) for scene in find_scenes(data_folder)], HOWS),
    }
    for name, (find, hows) in known.items():
        try:
            pairs += [Restarted(pair, how, trial, seed) for how in hows for trial, pair in enumerate(find())]
        except InputError as error:
            skipped.append(f"{TRUST} of {name}: {error}")
    return pairs, skipped
