"""Kinect covariances for registration: the sensor's noise and the surface that its points are samples of, in one."""

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, unit_vectors
from adagmm_o3d.neighbors import NeighborIndex
from adagmm_o3d.uncertainty.nguyen2012 import estimate_nguyen_covariances

NEIGHBORS = 4
"""So many nearest neighbours say how far apart the samples of the surface are."""


def estimate_kinect_surface_covariances(
    points: ArrayLike, normals: ArrayLike, focal_length: float | tuple[float, float]
) -> Array:
    """Covariance of each Kinect point in metres²: its noise, and along the surface the spacing of the samples.

    Σ = Σ_noise + s² (I − n nᵀ)

    with Σ_noise of `estimate_nguyen_covariances`, n the normal, and s² the mean squared distance of the four nearest
    points. Two clouds of one surface have no point in common: what corresponds to a point lies anywhere between the
    other cloud's samples, along the surface as far off as they are apart, across it as far as the sensor errs. The two
    errors are independent, so their covariances add. Noise alone says something else: it is smallest across the view,
    so it holds a point where it was sampled, and leaves it free along the ray, which is where its surface holds it.

    Parameters
    ----------
    points, normals, focal_length : as `estimate_nguyen_covariances` takes them, (N, 3) [m], (N, 3) and [px].

    Returns
    -------
    (N, 3, 3) float64 [m²], positive definite.

    Raises
    ------
    InputTypeError, InputError  as `estimate_nguyen_covariances` does.

    Source
    ------
    Noise: Nguyen, Izadi, Lovell, Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking, 3DIMPVT
    2012.   Wide along the surface: A. Segal, D. Haehnel, S. Thrun, Generalized-ICP, RSS 2009, Section III; the measured
    spacing in place of a constant is ours.
    """
    noise = estimate_nguyen_covariances(points, normals, focal_length)
    if len(noise) == 0:
        return noise
    p = np.ascontiguousarray(points, np.float64)
    n = unit_vectors("normals", normals, ("N", 3))
    squares = NeighborIndex(p).query(p, 1 + NEIGHBORS)[1]  # the first is the point itself
    spacing_sq = squares[:, 1:].mean(axis=1) if squares.shape[1] > 1 else np.zeros(len(p))
    return noise + spacing_sq[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None, :])
