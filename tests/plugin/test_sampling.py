"""What stands for many values: the quantiles that are points of the sample, and a part that is always the same."""

import numpy as np
import pytest

from adagmm_o3d.sampling import distinct_places, quantile, some_of


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101])
@pytest.mark.parametrize("share", [0.0, 0.125, 0.5, 0.9, 1.0])
def test_quantiles_are_those_of_numpy_that_are_in_the_sample(n, share):
    values = np.random.default_rng([n, int(1000 * share)]).normal(size=(n, 3))
    kept = values.copy()
    np.testing.assert_array_equal(quantile(values, share), np.quantile(values, share, axis=0, method="lower"))
    np.testing.assert_array_equal(quantile(values[:, 0], share), np.quantile(values[:, 0], share, method="lower"))
    np.testing.assert_array_equal(values, kept)


def test_equal_values_and_the_ends():
    assert quantile(np.array([3.0, 3.0, 3.0, 7.0]), 0.5) == 3.0
    values = np.arange(11.0)[::-1]
    assert [quantile(values, share) for share in (0.0, 0.25, 0.5, 0.99, 1.0)] == [0.0, 2.0, 5.0, 9.0, 10.0]


def test_some_are_chosen_from_all_over_and_always_the_same():
    index = np.arange(100, 1100)
    chosen = some_of(index, 200)
    np.testing.assert_array_equal(chosen, some_of(index, 200))
    assert len(chosen) == len(np.unique(chosen)) == 200 and np.isin(chosen, index).all()
    assert (np.diff(chosen) > 0).all() and abs(chosen.mean() - index.mean()) < 50
    np.testing.assert_array_equal(some_of(index, 1000), index)


def test_each_place_counts_once():
    points = np.random.default_rng(0).integers(-2, 3, (60, 3)).astype(float)
    points[points == 0.0] *= -1.0  # minus zero is the same place
    places, first = np.unique(points, axis=0, return_index=True)
    np.testing.assert_array_equal(distinct_places(points), first)
    np.testing.assert_array_equal(points[distinct_places(points)], places)
    assert len(distinct_places(np.empty((0, 3)))) == 0
