"""Clouds of known shape for tests: asymmetric, so that one pose is right and no other."""

import numpy as np


def bumpy_ellipsoid(rng, n):
    """(n, 3) points on a closed surface of radius about one, and their unit normals."""
    u = rng.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    axes = np.array([1.0, 0.7, 0.45])
    x, y, z = u.T
    phase = 3.0 * np.arctan2(y, x) + 1.0
    bumps = 1.0 + 0.25 * np.sin(phase) * (1.0 - z**2) + 0.2 * x**3
    turning = 0.75 * np.cos(phase) * (1.0 - z**2) / (x**2 + y**2)
    slopes = np.stack([0.6 * x**2 - turning * y, turning * x, -0.5 * np.sin(phase) * z], axis=1)
    # two steps on the sphere, and where they lead on the surface
    steps = np.cross(u, np.eye(3)[np.abs(u).argmin(axis=1)])
    steps = np.stack([steps, np.cross(u, steps)])
    along = (steps * bumps[:, None] + u * (steps * slopes).sum(axis=2, keepdims=True)) * axes
    normals = np.cross(*along)
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


def rectangle(rng, corner, *edges, density=150.0):
    """(n, 3) points on a rectangle, `density` on a unit of area."""
    corner, edges = np.array(corner), np.array(edges, dtype=float)
    count = int(density * np.prod(np.linalg.norm(edges, axis=1)))
    return corner + rng.random((count, 2)) @ edges


def corner_room(rng):
    """A floor and two walls, with a cupboard at one of them; x along that wall."""
    return np.concatenate(
        [
            rectangle(rng, (0, 0, 0), (5, 0, 0), (0, 3, 0)),
            rectangle(rng, (0, 0, 0), (5, 0, 0), (0, 0, 2.5)),
            rectangle(rng, (0, 0, 0), (0, 3, 0), (0, 0, 2.5)),
            rectangle(rng, (1.6, 0.6, 0), (0.8, 0, 0), (0, 0, 1.8)),
            rectangle(rng, (1.6, 0, 0), (0, 0.6, 0), (0, 0, 1.8)),
            rectangle(rng, (2.4, 0, 0), (0, 0.6, 0), (0, 0, 1.8)),
        ]
    )


DOOR = 1.3  # from each to the next


def corridor(rng):
    """A floor and a wall with six doors, each a little recessed; x along it."""
    parts = [rectangle(rng, (0, 0, 0), (6 * DOOR, 0, 0), (0, 2.4, 0), density=100.0)]
    for x in DOOR * np.arange(6):
        parts.append(rectangle(rng, (x, 0, 0), (0.5, 0, 0), (0, 0, 2.2)))
        parts.append(rectangle(rng, (x + 0.5, -0.15, 0), (0.8, 0, 0), (0, 0, 2.2)))
        parts += [rectangle(rng, (x + side, -0.15, 0), (0, 0.15, 0), (0, 0, 2.2)) for side in (0.5, 1.3)]
    return np.concatenate(parts)
