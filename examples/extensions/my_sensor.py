"""A sensor model of your own: a time-of-flight camera with 5 mm of noise along the ray and 1 pixel across it.

    [project.entry-points."adagmm_o3d.sensor_models"]
    my-tof = "my_sensor:estimate_covariances"

in your package's pyproject.toml is all that makes it known.
"""

import numpy as np


def estimate_covariances(points, normals, focal_lengths):
    """(N, 3, 3) [m²] of points (N, 3) [m, camera frame]; their normals make no difference."""
    ranges = np.linalg.norm(points, axis=1)
    rays = points / ranges[:, None]
    along = rays[:, :, None] * rays[:, None, :]
    across = (ranges / focal_lengths[0]) ** 2
    return 0.005**2 * along + across[:, None, None] * (np.eye(3) - along)
