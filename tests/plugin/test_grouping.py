"""Merged points against the sums written out."""

import numpy as np
import pytest

from adagmm_o3d.grouping import Groups


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
