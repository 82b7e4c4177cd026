"""Surfaces of many kinds, sampled at random: bodies, parts made of boxes, rooms, and what repeats itself."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from adagmm_bench.pairs.problem import cloud_of_points

# Hidden points are found on a sphere of so many times the distance.
HIDING = 60.0


def body(rng: np.random.Generator, n: int, dimension: int) -> np.ndarray:
    """(about n, D) of radius about one: a blob with up to three smaller ones on it, smooth or rough."""
    smaller = int(rng.integers(4))
    share = 1.0 / (1.0 + 0.3 * smaller)
    parts = [_blob(rng, round(share * n), dimension)]
    for _ in range(smaller):
        scale, at = rng.uniform(0.15, 0.5), parts[0][rng.integers(len(parts[0]))]
        parts.append(scale * _blob(rng, round(0.3 * share * n), dimension) + at)
    return np.concatenate(parts)


def _blob(rng: np.random.Generator, n: int, dimension: int) -> np.ndarray:
    """(n, D): a stretched sphere, in the plane a circle, whose radius carries random waves."""
    directions = rng.standard_normal((n, dimension))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    waves = rng.normal(0.0, rng.uniform(0.8, 2.5), (dimension, 8))
    phases = rng.uniform(0.0, 2.0 * np.pi, 8)
    radius = np.exp(rng.uniform(0.03, 0.18) * np.cos(directions @ waves + phases).sum(axis=1))
    return directions * radius[:, None] * rng.uniform(0.5, 1.3, dimension)


def part(rng: np.random.Generator, n: int, dimension: int = 3) -> np.ndarray:
    """(about n, D): two to six boxes that touch each other, as of machines and furniture."""
    extents = [rng.uniform(0.3, 2.0, dimension)]
    centres = [np.zeros(dimension)]
    for _ in range(rng.integers(1, 6)):
        on, extent = int(rng.integers(len(centres))), rng.uniform(0.15, 1.0, dimension)
        axis = rng.integers(dimension)
        at = centres[on] + rng.uniform(-0.4, 0.4, dimension) * extents[on]
        at[axis] = centres[on][axis] + rng.choice([-0.5, 0.5]) * (extents[on][axis] + extent[axis])
        centres.append(at)
        extents.append(extent)
    return _boxes(rng, n, np.array(centres), np.array(extents))


def room(rng: np.random.Generator, n: int) -> np.ndarray:
    """(about n, 3): a floor of about two by two, two to four walls, and things that stand there."""
    width, depth, height = rng.uniform(1.4, 2.6), rng.uniform(1.4, 2.6), rng.uniform(0.8, 1.4)
    walls = [((0, 0, 0), (width, depth, 0)), ((0, depth / 2, height / 2), (width, 0, height))]
    sides = [
        ((-width / 2, 0, height / 2), (0, depth, height)),
        ((width / 2, 0, height / 2), (0, depth, height)),
        ((0, -depth / 2, height / 2), (width, 0, height)),
    ]
    walls += [sides[i] for i in rng.permutation(3)[: rng.integers(1, 4)]]
    bare = _boxes(rng, round(0.5 * n), *np.array(walls, dtype=float).transpose(1, 0, 2))
    things = int(rng.integers(3, 9))
    return np.concatenate([bare, *(_standing(rng, n // (2 * things), width, depth) for _ in range(things))])


def _standing(rng: np.random.Generator, n: int, width: float, depth: float) -> np.ndarray:
    """(about n, 3): a thing anywhere on a floor."""
    thing = rng.uniform(0.12, 0.4) * (part(rng, n) if rng.random() < 0.6 else body(rng, n, 3))
    thing = thing @ about_vertical(rng.uniform(0.0, 2.0 * np.pi)).T
    thing[:, 2] -= thing[:, 2].min()
    return thing + np.array([*(rng.uniform(-0.45, 0.45, 2) * (width, depth)), 0.0])


def clutter(rng: np.random.Generator, n: int) -> np.ndarray:
    """(about n, 3): things close together on a table, some with a wall behind."""
    things = int(rng.integers(3, 9))
    parts = [_standing(rng, n // (things + 2), 1.6, 1.6) for _ in range(things)]
    parts.append(np.column_stack([rng.uniform(-1.2, 1.2, (n // (things + 2), 2)), np.zeros(n // (things + 2))]))
    if rng.random() < 0.5:
        wall = rng.uniform((-1.2, 0.0), (1.2, 1.3), (n // (things + 2), 2))
        parts.append(np.column_stack([wall[:, 0], np.full(len(wall), 1.2), wall[:, 1]]))
    return np.concatenate(parts)


def repeated(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """(about n, 3) of stairs, a shelf or a front with windows, on which something stands out; and (3,) its period."""
    count, rise = int(rng.integers(4, 9)), rng.uniform(0.15, 0.4)
    period = np.array([rng.choice([0.0, rng.uniform(0.2, 0.4)]), 0.0, rise])
    centres, extents = [], []
    for step in range(count):
        centres += [step * period, step * period + (0.15, 0.0, rise / 2)]
        extents += [(0.3, 1.6, 0.0), (0.0, 1.6, rng.choice([rise, 0.5 * rise]))]
    points = [_boxes(rng, n, np.array(centres), np.array(extents))]
    for _ in range(rng.integers(1, 6)):
        thing = rng.uniform(0.05, 0.2) * part(rng, n // 20)
        points.append(thing + rng.integers(count) * period + (0.0, rng.uniform(-0.7, 0.7), 0.1))
    return np.concatenate(points), period


def nearly_symmetric(rng: np.random.Generator, n: int, dimension: int) -> np.ndarray:
    """(about n, D): a shape that is itself half a turn on, about one axis at least, but for something small on it."""
    if dimension == 3 and rng.random() < 0.5:
        whole = _boxes(rng, n, np.zeros((1, 3)), rng.uniform(0.4, 2.0, (1, 3)))
    else:
        half = body(rng, n, dimension)
        turned = half * ([-1.0, -1.0, 1.0][:dimension])
        whole = np.concatenate([half[::2], turned[1::2]])
    thing = rng.uniform(0.1, 0.45) * _blob(rng, round(rng.uniform(0.02, 0.15) * n), dimension)
    return np.concatenate([whole, thing + whole[rng.integers(len(whole))]])


def seen_from(rng: np.random.Generator, points: np.ndarray, camera: np.ndarray, bias: float) -> np.ndarray:
    """(m, 3) of (n, 3) points [m], as a depth camera sees them: what is hidden is missing, depth is noisy, in steps and
    bent by up to `bias` per cent, and some points are off at edges."""
    distance = float(np.linalg.norm(camera))
    cloud = cloud_of_points(points)
    indices = o3d.geometry.PointCloud.hidden_point_removal(cloud, camera, HIDING * distance)[1]
    rays = points[indices] - camera
    depth = np.linalg.norm(rays, axis=1)
    wave = np.sin(points[indices] @ rng.normal(0.0, 2.0, 3) + rng.uniform(0.0, 6.0))
    deviation = (0.0012 + 0.0019 * (depth - 0.4) ** 2) * rng.uniform(0.5, 2.0)
    measured = depth + 0.01 * bias * depth * wave + deviation * rng.standard_normal(len(depth))
    step = 0.0028 * depth**2 * rng.uniform(0.3, 1.0)
    measured = np.round(measured / step) * step
    flying = rng.random(len(depth)) < rng.uniform(0.0, 0.06)
    measured[flying] += rng.uniform(-0.15, 0.15, int(flying.sum()))
    return camera + rays * (measured / depth)[:, None]


def about_vertical(angle: float) -> np.ndarray:
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])


def _boxes(rng: np.random.Generator, n: int, centres: np.ndarray, extents: np.ndarray) -> np.ndarray:
    """(n, D): the faces of (k, D) boxes by their areas; in the plane the edges by their lengths."""
    dimension = centres.shape[1]
    areas = np.stack([np.delete(extents, axis, axis=1).prod(axis=1) for axis in range(dimension)], axis=1)
    face = rng.choice(areas.size, n, p=areas.ravel() / areas.sum())
    box, axis = np.divmod(face, dimension)
    inside = rng.uniform(-0.5, 0.5, (n, dimension))
    inside[np.arange(n), axis] = rng.choice([-0.5, 0.5], n)
    return centres[box] + inside * extents[box]
