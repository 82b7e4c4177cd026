"""Merged points against the sums written out."""

import numpy as np
import pytest

from adagmm_o3d.grouping import AXIS_BITS, Groups, cell_numbers


@pytest.fixture
def points():
    rng = np.random.default_rng(0)
    return rng.integers(-3, 9, 200), rng.uniform(0.5, 2.0, 200), rng.normal(size=(200, 3, 3))


def test_means_of_groups(points):
    labels, weights, values = points
    groups = Groups(labels, weights)
    assert len(groups) == len(np.unique(labels))
    for k, label in enumerate(np.unique(labels)):
        own = labels == label
        assert groups.total[k] == pytest.approx(weights[own].sum())
        expected = np.average(values[own], axis=0, weights=weights[own])
        np.testing.assert_allclose(groups.means(values)[k], expected, rtol=1e-12)
        np.testing.assert_allclose(groups.means(weights)[k], np.average(weights[own], weights=weights[own]), rtol=1e-12)


def test_every_point_is_told_what_its_group_is(points):
    labels, weights, _ = points
    names = np.unique(labels).astype(float)
    np.testing.assert_array_equal(Groups(labels, weights).each(names), labels)
    pairs = np.stack([names, -names], axis=1)
    np.testing.assert_array_equal(Groups(labels, weights).each(pairs), np.stack([labels, -labels], axis=1))


def test_points_of_one_cell_edge_and_kind_have_one_number():
    rng = np.random.default_rng(1)
    points = np.concatenate([rng.uniform(-2.0, 2.0, (300, 3)), rng.uniform(-2.0, 2.0, (300, 3))])
    edges, kinds = rng.choice([0.5, 1.0], 600), rng.integers(0, 3, 600)
    numbers = cell_numbers(points, edges, kinds)
    assert (numbers >= 0).all()
    cells = np.floor(points / edges[:, None])
    same = (cells[:, None] == cells).all(axis=2) & (kinds[:, None] == kinds)
    np.testing.assert_array_equal(numbers[:, None] == numbers, same)
    np.testing.assert_array_equal(cell_numbers(points, edges), cell_numbers(points, edges, np.zeros(600, np.int64)))


def test_what_is_too_far_out_has_a_number_of_its_own():
    half = float(1 << (AXIS_BITS - 1))
    points = np.array([[half, 0.0], [half, 0.0], [half - 1.0, 0.0], [0.0, -half], [0.0, 1.0 - half]])
    numbers = cell_numbers(points, np.ones(5))
    assert (numbers < 0).tolist() == [True, True, False, True, False]
    assert len(set(numbers.tolist())) == 5
