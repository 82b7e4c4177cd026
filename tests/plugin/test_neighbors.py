"""The k-d tree finds what looking at every point finds, wherever the points lie."""

import numpy as np
import pytest

from adagmm_o3d.errors import InputError
from adagmm_o3d.kernels.cpu.nearest_k import LEAF, build_tree, count_nodes
from adagmm_o3d.neighbors import NeighborIndex


def naive(points, queries, k):
    """The nearest k, of those equally near the first."""
    squares = ((queries[:, None] - points) ** 2).sum(axis=2)
    indices = np.argsort(squares, axis=1, kind="stable")[:, :k]
    return indices, np.take_along_axis(squares, indices, axis=1)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(("count", "k"), [(1, 1), (5, 5), (16, 3), (17, 17), (1000, 1), (1000, 20)])
def test_the_nearest_are_found_in_their_order(dimension, count, k):
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, dimension))
    queries = np.concatenate([points[:50], rng.normal(scale=3.0, size=(200, dimension))])
    wanted, wanted_squares = naive(points, queries, k)
    indices, squares = NeighborIndex(points).query(queries, k)
    np.testing.assert_array_equal(indices, wanted)
    np.testing.assert_allclose(squares, wanted_squares, rtol=1e-12, atol=1e-15)


def test_of_equal_points_and_on_a_grid_the_first_are_taken():
    grid = np.stack(np.meshgrid(*[np.arange(6.0)] * 3), axis=-1).reshape(-1, 3)
    points = np.concatenate([grid, grid])
    wanted, wanted_squares = naive(points, grid, 8)
    indices, squares = NeighborIndex(points).query(grid, 8)
    np.testing.assert_array_equal(squares, wanted_squares)
    np.testing.assert_array_equal(indices, wanted)


# A scan's rings go out and back along either axis, many times; sorted points, and points that are all one.
TURNS = 2.0 * np.pi * np.linspace(0.0, 8.0, 4000)
PLACED = {
    "rings": np.column_stack([np.cos(TURNS), np.sin(TURNS), np.repeat(np.arange(8.0), 500)]),
    "sorted": np.linspace(-1.0, 1.0, 12_000).reshape(-1, 3),
    "in one place": np.full((4000, 3), 0.25),
}


@pytest.mark.parametrize("name", PLACED)
def test_a_run_is_halved_however_the_points_are_placed(name):
    points = PLACED[name]
    queries = points[::97] + 0.01
    wanted, wanted_squares = naive(points, queries, 4)
    indices, squares = NeighborIndex(points).query(queries, 4)
    np.testing.assert_array_equal(indices, wanted)
    np.testing.assert_allclose(squares, wanted_squares, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("dimension", [2, 3])
def test_only_what_is_within_a_distance_is_found(dimension):
    rng = np.random.default_rng(5)
    points, queries = rng.normal(size=(400, dimension)), 2.0 * rng.normal(size=(150, dimension))
    wanted, squares_wanted = naive(points, queries, 3)
    near = squares_wanted < 0.4**2
    assert near.any()
    assert not near.all()
    indices, squares = NeighborIndex(points).query(queries, 3, within=0.4)
    np.testing.assert_array_equal(indices, np.where(near, wanted, len(points)))
    np.testing.assert_allclose(squares, np.where(near, squares_wanted, 0.4 * 0.4), rtol=1e-12)


@pytest.mark.parametrize("name", ["rings", "sorted"])
def test_the_halves_of_a_run_lie_apart_along_its_longest_extent(name):
    """Without that the nearest would be found all the same, by looking at every point."""
    points = PLACED[name]
    order, boxes = np.empty(len(points), np.int64), np.empty((count_nodes(len(points)), 2, 3))
    build_tree(points, order, boxes)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(points)))
    runs, parted = [(0, len(points), 1)], 0
    while runs:
        first, last, node = runs.pop()
        run = points[order[first:last]]
        np.testing.assert_array_equal(boxes[node], [run.min(axis=0), run.max(axis=0)])
        if last - first > LEAF:
            axis, middle = np.argmax(np.ptp(boxes[node], axis=0)), (first + last) // 2
            assert boxes[2 * node, 1, axis] <= boxes[2 * node + 1, 0, axis]
            runs += [(first, middle, 2 * node), (middle, last, 2 * node + 1)]
            parted += 1
    assert parted > len(points) / (2 * LEAF)


def test_fewer_points_than_asked_for_are_all_that_is_found():
    indices, squares = NeighborIndex(np.eye(3)).query(np.zeros((2, 3)), 5)
    assert indices.tolist() == [[0, 1, 2]] * 2
    assert squares.tolist() == [[1.0, 1.0, 1.0]] * 2


def test_no_queries_have_no_neighbours():
    indices, squares = NeighborIndex(np.eye(3)).query(np.empty((0, 3)), 2)
    assert indices.shape == squares.shape == (0, 2)


def test_no_points_are_refused_by_name():
    with pytest.raises(InputError, match=r"^target_points: expected at least one point, got none$"):
        NeighborIndex(np.empty((0, 3)), name="target_points")
