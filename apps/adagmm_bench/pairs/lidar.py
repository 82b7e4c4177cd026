"""LiDAR scans: recorded pairs, simulated ones with exact truth, and a drive along a street; whole and thinned."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from adagmm_bench.pairs.lidar_scene import Lidar, Street, drive, scan_pair
from adagmm_bench.pairs.problem import PairClouds, PairSource, plain_pair
from adagmm_bench.pairs.public import PublicPair, find_public_pairs
from adagmm_bench.pairs.tables import pose_cpu_seconds
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import rotation_error_deg
from adagmm_o3d.lie import se_inverse

LIDAR, ODOMETRY = "lidar", "odometry"
RECORDED = ("kitti_small_gicp", "lpm_cloud_1_0")
VOXEL = 0.25  # m, of the thinned scans
DISTANCES, ANGLES_DEG = (0.1, 2.0), (0.0, 10.0)  # between two scans: m, and about the vertical
SCANS = 50
# What looks at the street: as exact as a beam can be, or as wide as beams are.
EXACT = "simulated"
SENSORS = {
    EXACT: Lidar(),
    "simulated, 64 wide beams": Lidar(n_rings=64, angular_noise=1e-3),
    "simulated, 128 wide beams": Lidar(n_rings=128, angular_noise=1e-3),
}
FOUND = (1.0, 0.2)  # degrees, m


@dataclass(frozen=True)
class Thinning:
    """A pair whole, or on a grid of VOXEL for everybody."""

    pair: PairSource
    thinned: bool

    @property
    def key(self) -> str:
        return f"{self.pair.key}, {self._how}"

    @property
    def _how(self) -> str:
        return f"voxels of {VOXEL} m" if self.thinned else "whole"

    def content(self) -> str:
        return self.pair.content()

    def facts(self) -> dict:
        facts = self.pair.facts()
        group = "recorded" if facts["section"] != LIDAR else facts["group"]
        return facts | {"section": LIDAR, "group": f"{group}, {self._how}"}

    def load(self) -> PairClouds:
        pair = self.pair.load()
        pair = replace(pair, unit=1.0, limits=FOUND)
        if not self.thinned:
            return pair
        source, target = (cloud.voxel_down_sample(VOXEL) for cloud in (pair.source, pair.target))
        return replace(pair, source=source, target=target, peers_source=source, peers_target=target)


@dataclass(frozen=True)
class SimulatedScans:
    """Two scans of a street by one of SENSORS, 0.1 to 2 m and up to 10 degrees apart; each trial has its own street."""

    trial: int
    seed: int
    sensor: str = EXACT

    @property
    def key(self) -> str:
        return f"{self.sensor} scans #{self.trial} seed {self.seed}"

    def content(self) -> str:
        return "made points"

    def facts(self) -> dict:
        return {"section": LIDAR, "group": self.sensor, "pair": f"#{self.trial}"}

    def load(self) -> PairClouds:
        rng = np.random.default_rng([self.seed, self.trial])
        distance, angle = rng.uniform(*DISTANCES), rng.uniform(*ANGLES_DEG)
        source, target, T = scan_pair(1000 * self.seed + self.trial, distance, angle, SENSORS[self.sensor])
        return plain_pair(source, target, T, unit=1.0)


@dataclass(frozen=True)
class DrivenScans:
    """Scan `index` of a drive and the one before it, which is the target."""

    index: int
    seed: int

    @property
    def key(self) -> str:
        return f"driven scans {self.index} seed {self.seed}"

    def content(self) -> str:
        return "made points"

    def facts(self) -> dict:
        return {
            "section": LIDAR,
            "group": ODOMETRY,
            "pair": f"{self.index - 1} and {self.index}",
            "seed": self.seed,
        }

    def load(self) -> PairClouds:
        poses = drive(SCANS, seed=self.seed)
        source, target = (_driven(index, self.seed) for index in (self.index, self.index - 1))
        return plain_pair(source, target, se_inverse(poses[self.index - 1]) @ poses[self.index], unit=1.0)


@lru_cache(maxsize=2)
def _driven(index: int, seed: int) -> np.ndarray:
    return _street(seed).scan(drive(SCANS, seed=seed)[index], seed=1000 * seed + index).points


@lru_cache(maxsize=1)
def _street(seed: int) -> Street:
    return Street(seed)


def find_lidar_pairs(data_folder: Path | None, *, trials: int, seed: int) -> tuple[list[PairSource], list[str]]:
    """The simulated pairs, the recorded ones with a truth where there are any, and the drive; why some are left out.

    Thinned are those of exact beams alone.
    """
    pairs: list[PairSource] = []
    skipped: list[str] = []
    try:
        known = {pair.path.stem: pair for pair in find_public_pairs(data_folder)}
    except InputError as error:
        known = {}
        skipped.append(f"{LIDAR}, recorded: {error}")
    recorded: list[PublicPair] = []
    for name in RECORDED:
        if name not in known:
            skipped.append(f"{LIDAR}, {name}: not in the data folder")
        elif known[name].load().T_target_source is None:
            skipped.append(f"{LIDAR}, {name}: nobody measured its pose")
        else:
            recorded.append(known[name])
    for thinned in (False, True):
        pairs += [Thinning(pair, thinned) for pair in recorded]
        sensors = [EXACT] if thinned else SENSORS
        pairs += [
            Thinning(SimulatedScans(trial, seed, sensor), thinned) for sensor in sensors for trial in range(trials)
        ]
    pairs += [Thinning(DrivenScans(index, seed), False) for index in range(1, SCANS)]
    return pairs, skipped


def lidar_tables(
    records: Sequence[dict], name_of: Callable[[str], str]
) -> tuple[list[str], list[list], list[str], list[list]]:
    """Columns and rows of the errors, and those of the drift over the drive; `name_of` is what a method is called."""
    groups: dict[str, dict[str, list[dict]]] = {}
    for record in records:
        groups.setdefault(record["problem"]["group"], {}).setdefault(record["method"], []).append(record)
    rows = []
    for group, members in groups.items():
        for method, own in members.items():
            degrees = [record["rotation_error_deg"] for record in own]
            mm = [1000.0 * record["translation_error"] for record in own]
            cpu = np.median([(record["cpu_seconds"], pose_cpu_seconds(record)) for record in own], axis=0)
            numbers = (np.median(degrees), np.median(mm), max(degrees), max(mm))
            row = [f"{group}, {len(own)}", name_of(method)]
            row += [f"{n:.{d}f}" for n, d in zip(numbers, (3, 1, 3, 1), strict=True)]
            rows.append([*row, *(f"{seconds:.2f}" for seconds in cpu)])
    columns = ["pairs", "method", "median °", "median mm", "worst °", "worst mm", "CPU s", "of the pose"]
    drives = next((members for group, members in groups.items() if group.startswith(ODOMETRY)), {})
    drifts = [[name_of(method), *_drift(own)] for method, own in drives.items() if len(own) == SCANS - 1]
    return columns, rows, ["method", "drift °", "drift mm", "% of the way"], drifts


def _drift(records: Sequence[dict]) -> list[str]:
    """How far off the last pose of a drive is when each scan is put at the one before."""
    poses = drive(SCANS, seed=records[0]["problem"]["seed"])
    found, way = poses[0], float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())
    for record in sorted(records, key=lambda record: int(record["problem"]["pair"].split()[-1])):
        found = found @ np.array(record["T_target_source"])
    off = float(np.linalg.norm(found[:3, 3] - poses[-1][:3, 3]))
    return [f"{rotation_error_deg(poses[-1], found):.3f}", f"{1000.0 * off:.1f}", f"{100.0 * off / way:.3f}"]
