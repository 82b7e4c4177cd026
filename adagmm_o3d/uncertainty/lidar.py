"""Covariances of a spinning LiDAR's points: the noise of its beam, and the surface between its rings."""

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.arguments import Array, check_coordinates, float_array, real_number
from adagmm_o3d.errors import InputError
from adagmm_o3d.uncertainty.planes import find_planes

RANGE_NOISE = 0.02
"""Standard deviation of the range [m]; Ouster's OS1 repeats it to 1.5 to 3 cm where the return is strong."""

BEAM_NOISE = 1e-3
"""Standard deviation of the direction [rad]: of the beam itself, 0.13° to 0.18° wide at half its height in the OS1."""

EXTENT = 1.0
"""Standard deviation along a surface [m], as in Generalized ICP, where it is 1 and 3 cm across."""

MAX_RANGE = 1000.0
"""No LiDAR of this kind sees farther [m]; beyond it the numbers are millimetres."""

CELLS = (0.1, 0.2, 0.4, 0.8)
"""Edges of the cells [m] in which a neighbourhood is looked for, the smallest that will do."""

MOST = 20
"""A neighbourhood are so many cells at most."""

NO_RETURN = 1e6
"""How much vaguer a point at the sensor itself is; as `mark_outliers` has it."""


def estimate_lidar_covariances(
    points: ArrayLike,
    *,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    range_noise: float = RANGE_NOISE,
    beam_noise: float = BEAM_NOISE,
    extent: float = EXTENT,
) -> Array:
    """Covariance of each LiDAR point in metres²: wide along the surface, as thick as surface and beam make it.

    Σ = extent² (I − n nᵀ) + t² n nᵀ + range_noise² b bᵀ + (r · beam_noise)² (I − b bᵀ)

    with b the beam and r the range. So seen under an angle of incidence α, a surface is as thick as
    √(t² + range_noise² cos² α + r² beam_noise² sin² α): at grazing incidence by the width of the beam.

    n and t, the normal and the roughness, are those of the neighbourhood. The nearest points of a point are on its own
    ring and make a line, whatever the surface; so the cloud is thinned to one point in a cell first, and the cells grow
    until the neighbours span a plane. Where they never do, Σ = extent² I beside the noise of the beam.

    Parameters
    ----------
    points : (N, 3) [m].
    origin : (3,) [m], where the sensor was, in the frame of the points. A point there is a beam without a return and
        counts as an outlier.
    range_noise, beam_noise : standard deviations along [m] and across [rad] a beam, ≥ 0, of the sensor's data sheet.
    extent : standard deviation along the surface [m], > 0.

    Returns
    -------
    (N, 3, 3) float64 [m²], positive semidefinite; definite with any noise at all.

    Raises
    ------
    InputTypeError, InputError  if an argument is no finite array of that shape or a number is out of range, or a point
                                is more than 1000 m from the sensor (millimetres in place of metres).

    Source
    ------
    Beams: Ouster, OS1 data sheet (range repeatability, beam divergence as full width at half maximum, which is 2.355
    standard deviations).   Planes: A. Segal, D. Haehnel, S. Thrun, Generalized-ICP, RSS 2009, Section III; a measured
    thickness in place of a constant is ours, as are the growing cells.
    """
    p, seen_from = float_array("points", points, ("N", 3)), float_array("origin", origin, (3,))
    check_coordinates("points", p)
    check_coordinates("origin", seen_from)
    beams = p - seen_from
    along, across = (
        real_number(name, value, minimum=0.0)
        for name, value in (("range_noise", range_noise), ("beam_noise", beam_noise))
    )
    wide = real_number("extent", extent, above=0.0) ** 2
    ranges = np.linalg.norm(beams, axis=1)
    if not np.all(ranges <= MAX_RANGE):
        row = int(np.argmax(ranges > MAX_RANGE))
        raise InputError(
            f"points: expected metres, at most {MAX_RANGE:g} from the sensor, got {ranges[row]:g} at row {row}; "
            "divide by the unit first"
        )
    returned = ranges > 0.0
    normals, roughness = np.zeros(p.shape), np.zeros(len(p))
    if returned.any():
        normals[returned], variances = find_planes(p[returned], p[returned], CELLS, MOST)
        roughness[returned] = variances[:, 0]
    beams[returned] /= ranges[returned, None]
    beam = beams[:, :, None] * beams[:, None, :]
    normal = normals[:, :, None] * normals[:, None, :]
    sideways = ((ranges * across) ** 2)[:, None, None]
    covariances = wide * np.eye(3) - (wide - np.minimum(roughness, wide))[:, None, None] * normal
    covariances += along**2 * beam + sideways * (np.eye(3) - beam)
    covariances[~returned] = NO_RETURN * wide * np.eye(3)
    return covariances
