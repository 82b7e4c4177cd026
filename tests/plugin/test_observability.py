"""Which motions a shape leaves free, on shapes where that is known."""

import numpy as np
import pytest
from shapes import bumpy

from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.trust.observability import free_directions

FLAG = 1e6


def plane(rng, n):
    return np.concatenate([rng.uniform(-1.0, 1.0, (n, 2)), np.zeros((n, 1))], axis=1)


def sphere(rng, n):
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def tube(rng, n):
    """Round, open at both ends, along x."""
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    return np.stack([rng.uniform(-3.0, 3.0, n), np.cos(angle), np.sin(angle)], axis=1)


def corridor(rng, n):
    """Floor and two walls, three times as long as wide, open at both ends, along x."""
    across, side = rng.uniform(-1.0, 1.0, n), rng.integers(0, 3, n)
    y = np.where(side == 0, across, np.where(side == 1, -1.0, 1.0))
    z = np.where(side == 0, -1.0, across)
    return np.stack([rng.uniform(-3.0, 3.0, n), y, z], axis=1)


def cube(rng, n):
    points = rng.uniform(-1.0, 1.0, (n, 3))
    points[np.arange(n), rng.integers(0, 3, n)] = rng.choice([-1.0, 1.0], n)
    return points


def circle(rng, n):
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def line(rng, n):
    return np.stack([rng.uniform(-1.0, 1.0, n), np.zeros(n)], axis=1)


def unit(dimension, *axes):
    return np.eye(dimension)[list(axes)]


KNOWN = {
    plane: unit(6, 2, 3, 4),
    sphere: unit(6, 0, 1, 2),
    tube: unit(6, 0, 3),
    corridor: unit(6, 3),
    cube: unit(6)[:0],
    circle: unit(3, 0),
    line: unit(3, 1),
}


def free_of(source, covariances=None, matched=None, pose=None):
    mixture = normalise(*(make_mixture(name, source, covariances) for name in ("source", "target")))[0]
    return free_directions(
        mixture, np.eye(4) if pose is None else pose, np.ones(len(source)) if matched is None else matched
    )


def projector(directions, size):
    directions = np.reshape(directions, (-1, size))
    return directions.T @ directions


@pytest.mark.parametrize("shape", KNOWN)
@pytest.mark.parametrize("n", [600, 4000])
def test_the_free_directions_of_known_shapes(shape, n):
    expected = KNOWN[shape]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        points = shape(rng, n)
        free = free_of(points + 0.01 * rng.normal(size=points.shape))
        assert len(free) == len(expected)
        # the same space, whichever basis; turns are about the samples' centroid, which is not quite the shape's centre
        size = expected.shape[1]
        np.testing.assert_allclose(projector(free, size), projector(expected, size), rtol=0, atol=0.1)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_an_irregular_shape_leaves_nothing_free(dimension, noise):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        points = bumpy(rng, 600, dimension)
        assert free_of(points + noise * rng.normal(size=points.shape)) == ()


def test_free_directions_turn_with_the_pose():
    rng = np.random.default_rng(4)
    points = plane(rng, 800)
    # the plane z = 0 set upright: x → y → z → x, so that x is its normal
    pose = np.eye(4)
    pose[:3, :3] = np.roll(np.eye(3), 1, axis=0)
    np.testing.assert_allclose(
        projector(free_of(points, pose=pose), 6), projector(unit(6, 0, 4, 5), 6), rtol=0, atol=0.01
    )


def test_only_points_that_count_hold_the_pose():
    rng = np.random.default_rng(6)
    points = np.concatenate([plane(rng, 800), bumpy(rng, 200, 3)])
    of_plane = np.arange(1000) < 800
    assert free_of(points) == ()
    assert len(free_of(points, matched=of_plane.astype(float))) == 3
    variances = np.where(of_plane, 1.0, FLAG)
    assert len(free_of(points, variances[:, None, None] * np.eye(3))) == 3
