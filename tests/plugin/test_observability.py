"""Which motions a shape leaves free, on shapes where that is known."""

import numpy as np
import pytest
from shapes import bumpy

from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.trust.held_by_detail import free_of_detail
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


def with_frames(rng, n, at, depth=0.06):
    """The corridor with frames that stand out of its walls by `depth` at these places along it."""
    points = corridor(rng, n)
    for place in at:
        on = (np.abs(points[:, 0] - place) < 0.15) & (np.abs(points[:, 1]) == 1.0)
        points[on, 1] *= 1.0 - depth
    return points


IRREGULAR, EVEN = (-1.7, -0.4, 1.1), np.arange(-2.8, 3.0, 0.6)


@pytest.mark.parametrize(
    "at, off, held",
    [
        (IRREGULAR, 0.0, True),
        # somewhere along the way the frames meet again, or fit better
        (EVEN, 0.0, False),
        (IRREGULAR, 0.15, False),
        (IRREGULAR, -0.3, False),
        ((), 0.0, False),
    ],
)
def test_frames_hold_a_corridor_where_they_meet(at, off, held):
    for seed in range(3):
        rng = np.random.default_rng(seed)
        clouds = [with_frames(rng, 4000, at) + 0.01 * rng.normal(size=(4000, 3)) for _ in range(2)]
        source, target, normalisation = normalise(*(make_mixture("cloud", points, None) for points in clouds))
        pose = normalisation.pose_in(np.eye(4))
        pose[0, 3] += off
        free = np.array(free_directions(source, pose, np.ones(4000)))
        assert len(free) == 1  # next to nothing of the surfaces holds it
        np.testing.assert_array_equal(free_of_detail(source, target, pose, free), free[:0] if held else free)


@pytest.mark.parametrize("shape", [plane, sphere, tube, circle, line])
def test_where_there_is_no_detail_what_is_free_stays_free(shape):
    rng = np.random.default_rng(7)
    clouds = [shape(rng, 2000) for _ in range(2)]
    clouds = [points + 0.01 * rng.normal(size=points.shape) for points in clouds]
    source, target, normalisation = normalise(*(make_mixture("cloud", points, None) for points in clouds))
    free = np.array(free_directions(source, normalisation.pose_in(np.eye(4)), np.ones(2000)))
    assert len(free)
    np.testing.assert_array_equal(free_of_detail(source, target, normalisation.pose_in(np.eye(4)), free), free)


def test_so_few_points_have_no_detail():
    rng = np.random.default_rng(8)
    sides = normalise(*(make_mixture("cloud", rng.normal(size=(5, 3)), None) for _ in range(2)))[:2]
    free = unit(6, 3)
    np.testing.assert_array_equal(free_of_detail(*sides, np.eye(4), free), free)
