"""What every method is given: two clouds with covariances, and how they are brought to a common start and scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adagmm_o3d.errors import InputError

# A point counts as marked if its covariance is this many times that of the cloud's most certain tenth. The median would
# not do in place of the tenth: more than half of a cloud may be marked.
FLAGGED_RATIO, CERTAIN_QUANTILE = 1e4, 0.1

PREPARATIONS = {
    "as-given": "scaled only, the start is the identity",
    "centroids": "scaled, and the clouds' centroids brought together",
    "unflagged": "points marked as outliers removed, then scaled and centroids brought together",
}


@dataclass(frozen=True)
class Cloud:
    """points (n, D) float64, covariances (n, D, D) float64; D is 2 or 3. viewpoint (D,): where the sensor stood, if
    that is known.
    """

    points: np.ndarray
    covariances: np.ndarray
    viewpoint: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.points)

    def subset(self, keep: np.ndarray) -> Cloud:
        return Cloud(self.points[keep], self.covariances[keep], self.viewpoint)

    def rms_radius(self) -> float:
        return float(np.sqrt(np.mean(np.sum((self.points - self.points.mean(axis=0)) ** 2, axis=1))))

    def flagged(self) -> np.ndarray:
        """(n,) bool: points whose covariance says that they are outliers, or is not finite."""
        variance = np.trace(self.covariances, axis1=1, axis2=2)
        finite = np.isfinite(self.covariances).all(axis=(1, 2))
        certain = np.quantile(variance[finite], CERTAIN_QUANTILE) if finite.any() else np.nan
        return ~finite | ~(variance <= FLAGGED_RATIO * certain)


@dataclass(frozen=True)
class Problem:
    """A pair to register; T_target_source (D+1, D+1) is the truth where known."""

    name: str
    source: Cloud
    target: Cloud
    T_target_source: np.ndarray | None = None

    @property
    def dimension(self) -> int:
        return self.source.points.shape[1]


@dataclass(frozen=True)
class Prepared:
    """The clouds as a method sees them, in units of `scale`, and the way back to the pose between the given clouds."""

    source: Cloud
    target: Cloud
    source_offset: np.ndarray  # (D,) subtracted from the source before scaling
    target_offset: np.ndarray  # (D,)
    scale: float

    def restore(self, T_prepared: np.ndarray) -> np.ndarray:
        """The pose between the clouds as they were given, from the one between the prepared clouds."""
        D = len(self.source_offset)
        R = T_prepared[:D, :D]
        T = np.eye(D + 1)
        T[:D, :D] = R
        T[:D, D] = self.scale * T_prepared[:D, D] + self.target_offset - R @ self.source_offset
        return T

    def prepared_pose(self, T: np.ndarray) -> np.ndarray:
        """The way in: the pose between the prepared clouds, from the one between the clouds as they were given."""
        D = len(self.source_offset)
        T_prepared = np.array(T, dtype=float)
        T_prepared[:D, D] = (T[:D, D] - self.target_offset + T[:D, :D] @ self.source_offset) / self.scale
        return T_prepared


def prepare(problem: Problem, preparation: str) -> Prepared:
    """Scale both clouds by the larger RMS radius, as the paper does, and start as `preparation` says.

    Every method gets the same, so that one set of tuned distances, in radii, serves all data.
    """
    if preparation not in PREPARATIONS:
        raise InputError(f"start: expected one of {', '.join(PREPARATIONS)}, got {preparation!r}")
    clouds = {"source": problem.source, "target": problem.target}
    for role, cloud in clouds.items():
        usable = np.isfinite(cloud.covariances).all(axis=(1, 2)) & np.isfinite(cloud.points).all(axis=1)
        if preparation == "unflagged":
            usable &= ~cloud.flagged()
        if not usable.any():
            raise InputError(f"{problem.name}: the {role} has no usable point left with start {preparation!r}")
        clouds[role] = cloud.subset(usable)
    scale = max(cloud.rms_radius() for cloud in clouds.values())
    offsets = {
        role: np.zeros(problem.dimension) if preparation == "as-given" else cloud.points.mean(axis=0)
        for role, cloud in clouds.items()
    }
    scaled = {role: _scaled(cloud, offsets[role], scale) for role, cloud in clouds.items()}
    return Prepared(scaled["source"], scaled["target"], offsets["source"], offsets["target"], scale)


def _scaled(cloud: Cloud, offset: np.ndarray, scale: float) -> Cloud:
    viewpoint = None if cloud.viewpoint is None else (cloud.viewpoint - offset) / scale
    return Cloud((cloud.points - offset) / scale, cloud.covariances, viewpoint)
