"""Matched features of two colour images as measurements of a pose: where the source's fall in the target's image."""

from dataclasses import dataclass

import numpy as np

from adagmm_fusion.frames.depth_geometry import project
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.measurements.depth_errors import by_depth
from adagmm_fusion.measurements.residuals import (
    LEAST,
    NormalEquations,
    Residuals,
    counted_once,
    normal_equations,
    squares,
)
from adagmm_o3d.lie import moved_by
from adagmm_o3d.uncertainty.nguyen2012 import estimate_nguyen_covariances

# Standard deviation of a feature's place in an image [px]; where matches say they are better, at best half of it.
PIXEL, LEAST_SCALE = 1.0, 0.25
# A match agrees with a pose up to this squared residual, in variances; it may pull on one up to the other.
AGREES_SQ, NEAR_SQ = 9.0, 100.0
# Of the matches that pass the ratio test so many may be wrong.
WRONG = 0.9


@dataclass(frozen=True, eq=False)
class FeatureMatches:
    """Features seen in both images.

    points : (n, 3) [m], source frame, lifted by its depth.   pixels : (n, 2) x and y in the target's image.
    """

    points: np.ndarray
    pixels: np.ndarray

    def take(self, chosen: np.ndarray) -> "FeatureMatches":
        """Those at an index or mask."""
        return FeatureMatches(self.points[chosen], self.pixels[chosen])

    def __len__(self) -> int:
        return len(self.points)


class FeatureMeasurements:
    """The reprojection of matches; a lifted point's own error, by its depth, comes with it."""

    def __init__(self, matches: FeatureMatches, source: PinholeIntrinsics, target: PinholeIntrinsics) -> None:
        self._matches, self._target = matches, target
        rays = matches.points / np.maximum(np.linalg.norm(matches.points, axis=1, keepdims=True), 1e-12)
        self._covariances = estimate_nguyen_covariances(matches.points, -rays, (source.fx, source.fy))

    def equations(self, T_target_source: np.ndarray, most: int) -> NormalEquations | None:
        """What the matches near a pose say of it; all of them, whatever `most` is."""
        residuals, _ = self._residuals(T_target_source)
        near = squares(residuals) < NEAR_SQ
        if near.sum() < LEAST:
            return None
        return normal_equations(residuals.take(near), LEAST_SCALE)

    def agreeing(self, T_target_source: np.ndarray) -> int:
        """How many matches agree with a pose."""
        return int(np.count_nonzero(squares(self._residuals(T_target_source)[0]) < AGREES_SQ))

    def evidence(self, T_target_source: np.ndarray) -> float:
        """Log-likelihood ratio of a pose [nats]: matches where it puts them, over ones anywhere in the image."""
        residuals, areas = self._residuals(T_target_source)
        image = self._target.width * self._target.height
        likely = np.exp(-0.5 * np.minimum(squares(residuals), NEAR_SQ)) * image / (2.0 * np.pi * areas)
        return counted_once(residuals.places, np.log((1.0 - WRONG) * likely + WRONG))

    def _residuals(self, T_target_source: np.ndarray) -> tuple[Residuals, np.ndarray]:
        """Of the matches that the target can see at the pose, with the area of each one's deviation [px²]."""
        k, R, t = self._target, T_target_source[:3, :3], T_target_source[:3, 3]
        points = self._matches.points @ R.T + t
        pixels = project(points, k).T
        seen = np.isfinite(pixels[:, 0]) & (points[:, 2] > 0.0)
        points, off = points[seen], (pixels - self._matches.pixels)[seen]
        z = points[:, 2]
        by_point = np.zeros((len(points), 2, 3))
        by_point[:, 0, 0], by_point[:, 0, 2] = k.fx / z, -k.fx * points[:, 0] / z**2
        by_point[:, 1, 1], by_point[:, 1, 2] = k.fy / z, -k.fy * points[:, 1] / z**2
        by_source = by_point @ R
        covariances = by_source @ self._covariances[seen] @ by_source.transpose(0, 2, 1) + PIXEL**2 * np.eye(2)
        whitening = np.linalg.inv(np.linalg.cholesky(covariances))
        values = np.einsum("nij,nj->ni", whitening, off)
        areas = np.sqrt(np.linalg.det(covariances))
        of_source = whitening @ by_point @ by_depth(points - t, self._matches.points[seen, 2])
        # The target's depth has no part in it.
        of_depth = np.concatenate([of_source, np.zeros_like(of_source)], axis=2)
        return Residuals(values, whitening @ by_point @ moved_by(points), of_depth, points), areas
