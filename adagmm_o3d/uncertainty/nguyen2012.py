"""The Kinect noise model of Nguyen, Izadi and Lovell (2012): metric, axial and lateral, an ellipsoid along the ray."""

import math

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, float_array, real_number
from adagmm_o3d.errors import InputError
from adagmm_o3d.uncertainty.viewing import depth_and_incidence

GRAZING_ANGLE = math.pi / 3.0
"""Beyond this angle of incidence [rad] the axial noise has its grazing term."""

MAX_ANGLE = math.radians(85.0)
"""Angles of incidence are clipped here [rad]: both terms diverge at 90°, and nothing was measured so close to it."""


def nguyen_axial_sigma(depth: ArrayLike, angle: ArrayLike) -> Array:
    """Standard deviation of the depth.

    Parameters
    ----------
    depth : z [m], > 0; broadcast against the angle.
    angle : between normal and ray [rad], 0 … π/2, clipped at `MAX_ANGLE`.

    Returns
    -------
    float64 array [m]: 0.0012 + 0.0019 (z − 0.4)², and beyond 60° also 0.0001/√z · θ²/(π/2 − θ)².

    Source
    ------
    Nguyen, Izadi, Lovell, Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking, 3DIMPVT 2012.
    """
    z = np.asarray(depth, float)
    theta = np.minimum(np.asarray(angle, float), MAX_ANGLE)
    grazing = 0.0001 / np.sqrt(z) * (theta / (0.5 * math.pi - theta)) ** 2
    return 0.0012 + 0.0019 * (z - 0.4) ** 2 + np.where(theta > GRAZING_ANGLE, grazing, 0.0)


def nguyen_lateral_sigma_px(angle: ArrayLike) -> Array:
    """Standard deviation of the pixel position along either image axis.

    Parameters
    ----------
    angle : between normal and ray [rad], 0 … π/2, clipped at `MAX_ANGLE`.

    Returns
    -------
    float64 array [px]: 0.8 + 0.035 θ/(π/2 − θ); times z/f it is metres.

    Source
    ------
    Nguyen, Izadi, Lovell, Modeling Kinect Sensor Noise for Improved 3D Reconstruction and Tracking, 3DIMPVT 2012.
    """
    theta = np.minimum(np.asarray(angle, float), MAX_ANGLE)
    return 0.8 + 0.035 * theta / (0.5 * math.pi - theta)


def estimate_nguyen_covariances(
    points: ArrayLike, normals: ArrayLike, focal_length: float | tuple[float, float]
) -> Array:
    """Covariance of each Kinect point in metres²: lateral across the image, axial along the viewing ray.

    The depth z and the pixel position are taken as independent and propagated through the back-projection
    p = z ((u − cx)/fx, (v − cy)/fy, 1) to first order: Σ = σ_z² r rᵀ + diag((σ_l z/fx)², (σ_l z/fy)², 0) with
    r = p/z the ray. At the image centre that is diag(lateral², lateral², axial²).

    Parameters
    ----------
    points : (N, 3) [m], camera frame (x right, y down, z forward).
    normals : (N, 3), any non-zero length and either sign.
    focal_length : f or (fx, fy) [px], of the image that the points come from.

    Returns
    -------
    (N, 3, 3) float64 [m²], positive definite.

    Raises
    ------
    InputTypeError  if an argument is not numbers.
    InputError      if shapes disagree, a number is not finite, a normal has length 0, a point is not in front of the
                    camera or the focal length is not positive.

    Source
    ------
    The standard deviations: Nguyen, Izadi, Lovell, Modeling Kinect Sensor Noise for Improved 3D Reconstruction and
    Tracking, 3DIMPVT 2012; the propagation along the ray is ours, their planes stood at the image centre.
    """
    fx, fy = _focal_lengths(focal_length)
    p, depth, cosine = depth_and_incidence(points, normals)
    angle = np.arccos(cosine)
    along_ray = p * (nguyen_axial_sigma(depth, angle) / depth)[:, None]
    lateral = nguyen_lateral_sigma_px(angle) * depth
    covariances = along_ray[:, :, None] * along_ray[:, None, :]
    covariances[:, 0, 0] += (lateral / fx) ** 2
    covariances[:, 1, 1] += (lateral / fy) ** 2
    return covariances


def _focal_lengths(value: float | tuple[float, float]) -> tuple[float, float]:
    if np.ndim(value) == 0:
        f = real_number("focal_length", value, above=0.0)
        return f, f
    fx, fy = float_array("focal_length", value, (2,))
    if min(fx, fy) <= 0.0:
        raise InputError(f"focal_length: expected fx, fy > 0 in pixels, got ({fx:g}, {fy:g})")
    return float(fx), float(fy)
