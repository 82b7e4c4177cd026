"""Random clouds with covariances for tests, 2D and 3D."""

import numpy as np

from adagmm_o3d.lie import se_exp
from adagmm_o3d.mixtures.colours import ColourModel


def random_points_and_covariances(rng, n, dimension, *, isotropic, radius=1.0):
    """(n, D) points and (n, D, D) positive definite covariances with eigenvalues of order one."""
    points = radius * rng.normal(size=(n, dimension))
    if isotropic:
        return points, rng.uniform(0.5, 3.0, n)[:, None, None] * np.eye(dimension)
    factors = rng.normal(size=(n, dimension, dimension))
    return points, factors @ factors.transpose(0, 2, 1) + 0.3 * np.eye(dimension)


def random_pose(rng, dimension, *, angle=0.4, distance=0.3):
    """A rigid motion, (D+1, D+1)."""
    size = dimension * (dimension + 1) // 2
    tangent = rng.normal(size=size)
    turn = size - dimension
    tangent[:turn] *= angle / np.linalg.norm(tangent[:turn])
    tangent[turn:] *= distance / np.linalg.norm(tangent[turn:])
    return se_exp(tangent)


def random_colours(m, n):
    """Colours (m, 3) and (n, 3) of two clouds, and a model by which some of the pairs lie."""
    rng = np.random.default_rng(m + n)
    colours = rng.normal(50.0, 8.0, (m, 3)), rng.normal(55.0, 8.0, (n, 3))
    deviations, gain, offset = np.array([12.0, 8.0, 9.0]), np.array([1.1, 1.0, 0.9]), np.array([2.0, -3.0, 4.0])
    return colours, ColourModel(deviations, gain, offset, lying=0.1, floor=1.5, expected=0.3)
