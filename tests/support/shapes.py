"""Clouds of known shape for tests: asymmetric, so that one pose is right and no other."""

import numpy as np


def bumpy_ellipsoid(rng, n):
    """(n, 3) points on a closed surface of radius about one, and their unit normals (those of the smooth ellipsoid)."""
    u = rng.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    axes = np.array([1.0, 0.7, 0.45])
    bumps = 1.0 + 0.25 * np.sin(3.0 * np.arctan2(u[:, 1], u[:, 0]) + 1.0) * (1.0 - u[:, 2] ** 2) + 0.2 * u[:, 0] ** 3
    normals = u / axes
    return u * axes * bumps[:, None], normals / np.linalg.norm(normals, axis=1, keepdims=True)


def bumpy_ellipse(rng, n):
    """(n, 2) points on a closed curve of radius about one."""
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    radius = 1.0 + 0.25 * np.sin(3.0 * angle + 1.0) + 0.2 * np.cos(angle) ** 3
    return radius[:, None] * np.stack([np.cos(angle), 0.6 * np.sin(angle)], axis=1)


def bumpy(rng, n, dimension):
    """(n, D) points of the one or the other."""
    return bumpy_ellipse(rng, n) if dimension == 2 else bumpy_ellipsoid(rng, n)[0]


def body_with_head(rng, n, dimension):
    """(n, D) points of a shape without any near-symmetry."""
    head = 0.5 * bumpy(rng, n // 3, dimension) + np.array([1.0, 0.5, 0.3])[:dimension]
    return np.concatenate([bumpy(rng, n - n // 3, dimension), head])


def move(points, transformation):
    """Points under a (D+1, D+1) transformation."""
    return points @ transformation[:-1, :-1].T + transformation[:-1, -1]


def turn(covariances, transformation):
    """Covariances under a (D+1, D+1) transformation."""
    rotation = transformation[:-1, :-1]
    return rotation @ covariances @ rotation.T
