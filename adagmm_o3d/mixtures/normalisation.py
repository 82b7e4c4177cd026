"""Two mixtures brought to a common scale, each about its own centroid, and poses carried in and out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.errors import InputError
from adagmm_o3d.mixtures.checks import BULK, BULK_SAMPLE, bulk_of, check_ratios
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.sampling import quantile, some_of

# Half of all points may be flagged as outliers: the unit of variance is that of a point among the best.
GOOD_SHARE = 0.125
# The digits of the unit.
UNIT_DIGITS = 12
# A variance this many times the unit is a flag more than a measurement.
VAGUE = 100.0
# What the kernels' float32 can tell apart: variances relative to the unit.
VARIANCE_RANGE = (1e-6, 1e12)
# A cloud is more than a dot when its bulk does not lie within this many radii of its median.
FINEST = 1e-3
# Clouds this many radii apart do not see each other, and float32 has no digits for more.
FARTHEST = 1e4


@dataclass(frozen=True)
class Normalisation:
    """The similarity that brings both clouds to their centroids and to unit radius (the paper, Section 4.1).

    Normalised p is (p - centre) / scale; `scale` is the larger of the two RMS radii [input units]. Covariances, which
    are relative, are divided by `variance`, a low percentile over both clouds: that of a good point becomes 1.
    `source_radius` and `target_radius` are the normalised ones; the larger is 1.
    """

    source_centre: Array
    target_centre: Array
    scale: float
    variance: float
    source_radius: float
    target_radius: float

    def sigma_out(self, sigma: float) -> float:
        """σ of the normalised mixtures → σ for the covariances as given, [input units² per unit of covariance]."""
        return sigma * self.scale**2 / self.variance

    def pose_in(self, transformation: Array) -> Array:
        """(4, 4) input pose → the same pose between normalised clouds, brought to within FARTHEST if farther apart."""
        pose = transformation.copy()
        offset = transformation[:3, :3] @ self.source_centre + transformation[:3, 3] - self.target_centre
        largest = float(np.abs(offset).max())
        if largest > FARTHEST * self.scale:
            offset *= FARTHEST * self.scale / largest
        pose[:3, 3] = offset / self.scale
        return pose

    def points_in(self, source: Array | None, target: Array | None) -> tuple[Array | None, Array | None]:
        """Points (3,) in the frames of the input clouds → the same in those of the normalised ones."""
        return (
            None if source is None else (source - self.source_centre) / self.scale,
            None if target is None else (target - self.target_centre) / self.scale,
        )

    def pose_out(self, pose: Array) -> Array:
        """(4, 4) or (k, 4, 4) poses between normalised clouds → the same between the input clouds."""
        out = pose.copy()
        out[..., :3, 3] = pose[..., :3, 3] * self.scale + self.target_centre - pose[..., :3, :3] @ self.source_centre
        return out


def normalise(source: Mixture, target: Mixture) -> tuple[Mixture, Mixture, Normalisation]:
    """Both mixtures with their own centroid at the origin, the larger RMS radius 1 and covariances of unit scale.

    A point counts for the centroid as far as it is certain; flagged outliers do not count for the radius either.

    Raises
    ------
    InputError : a cloud that is hardly more than a dot at that scale; variances with no number in the unit, on a GPU.
    """
    sides = (source, target)
    variances = [m.variances for m in sides]
    # A few units in the last place, by which the variances of a surface differ, must not tell one scale from another:
    # what was made of a prepared cloud is kept for the scale of the last registration.
    unit = float(f"{quantile(np.concatenate(variances), GOOD_SHARE):.{UNIT_DIGITS}g}")
    with np.errstate(over="ignore"):  # beyond all numbers is beyond the range
        relative = [np.minimum(np.maximum(v / unit, VARIANCE_RANGE[0]), VARIANCE_RANGE[1]) for v in variances]
    for name, m, v in zip(("source", "target"), sides, variances, strict=True):
        if m.on_device:
            check_ratios(name, v, unit)
    centres = [m.centroid(m.weights / r) for m, r in zip(sides, relative, strict=True)]
    certain = [_certain(r) for r in relative]
    radii = [m.radius(c, m.weights * k) for m, c, k in zip(sides, centres, certain, strict=True)]
    scale = max(radii)
    for name, m, k in zip(("source", "target"), sides, certain, strict=True):
        _check_resolution(name, _some_points(m, np.flatnonzero(k)), scale)
    moving, fixed = (m.normalised(c, scale, unit, r) for m, c, r in zip(sides, centres, relative, strict=True))
    return moving, fixed, Normalisation(centres[0], centres[1], scale, unit, radii[0] / scale, radii[1] / scale)


def _certain(relative: Array) -> NDArray[np.bool_]:
    """(n,) which points are not flagged as outliers; all where every one is."""
    certain: NDArray[np.bool_] = relative <= VAGUE
    return certain if certain.any() else ~certain


def _some_points(mixture: Mixture, index: NDArray[np.intp]) -> Array:
    """The points at `index`, a sample of them where there are more than BULK_SAMPLE."""
    return mixture.points_at(some_of(index, BULK_SAMPLE))


def _check_resolution(name: str, points: Array, scale: float) -> None:
    """Raise where a few points far away, or the other cloud, make a dot of a cloud's bulk."""
    bulk = math.sqrt(bulk_of(points)[1])
    if bulk < FINEST * scale:
        raise InputError(
            f"{name}.points: {BULK:.0%} lie within {bulk:.3g} of their median, but the radius of the clouds is "
            f"{scale:.3g}; check the units, remove far points or mark_outliers()"
        )
