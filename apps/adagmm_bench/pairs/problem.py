"""A pair of Open3D clouds as a script would hold them, and where such a pair comes from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import open3d as o3d

from adagmm_bench.problem import Cloud
from adagmm_bench.trial import TrialSource

FOUND_DEG = 5.0


@dataclass(frozen=True)
class PairClouds:
    """Clouds for ours (with covariances where the app makes them) and for other libraries, in one frame each.

    Attributes
    ----------
    unit : what other libraries get as 1 [input units]: a metre of a room, the RMS radius of anything else.
    T_target_source : (4, 4), the truth; None where there is none.
    centre : (3,) source point whose displacement is the translation error.
    limits : what is within this many degrees and units of the truth is found.
    related : False where the clouds share nothing, so that no pose is right.
    source_viewpoint, target_viewpoint : (3,) where the sensor stood, None where that is not known.
    init : (4, 4), the start that ours is given; other libraries start at the identity.
    """

    source: o3d.geometry.PointCloud
    target: o3d.geometry.PointCloud
    peers_source: o3d.geometry.PointCloud
    peers_target: o3d.geometry.PointCloud
    unit: float
    T_target_source: np.ndarray | None
    centre: np.ndarray
    limits: tuple[float, float] = (FOUND_DEG, 0.1)
    related: bool = True
    source_viewpoint: np.ndarray | None = None
    target_viewpoint: np.ndarray | None = None
    init: np.ndarray = field(default_factory=lambda: np.eye(4))

    def for_peers(self) -> tuple[Cloud, Cloud]:
        """The clouds in units of `unit`."""
        return (
            self._peer_cloud(self.peers_source, self.source_viewpoint),
            self._peer_cloud(self.peers_target, self.target_viewpoint),
        )

    def _peer_cloud(self, cloud: o3d.geometry.PointCloud, viewpoint: np.ndarray | None) -> Cloud:
        points = np.asarray(cloud.points) / self.unit
        covariances = np.broadcast_to(np.eye(3), (len(points), 3, 3))
        return Cloud(points, covariances, None if viewpoint is None else viewpoint / self.unit)


class PairSource(TrialSource, Protocol):
    """Where a pair comes from. Its facts are `section` and `group` of the tables, and the `pair`."""

    def load(self) -> PairClouds: ...


def plain_pair(source: np.ndarray, target: np.ndarray, T: np.ndarray | None, **more: Any) -> PairClouds:
    """Points (M, 3) and (N, 3), the same for everybody, whose unit is a radius if nothing else is said."""
    clouds = cloud_of_points(source), cloud_of_points(target)
    unit = max(rms_radius(source), rms_radius(target))
    return PairClouds(*clouds, *clouds, T_target_source=T, **({"unit": unit, "centre": source.mean(axis=0)} | more))


def cloud_of_points(points: np.ndarray) -> o3d.geometry.PointCloud:
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.asarray(points, dtype=float)))


def rms_radius(points: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
