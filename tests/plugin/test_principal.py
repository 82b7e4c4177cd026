"""Principal axes are what NumPy finds, of matrices of any size and shape; scatter is that of its words."""

import numpy as np
import pytest

from adagmm_o3d.principal import principal_axes, principal_variances, scatter_among


def symmetric(seed, spreads, count=200, dimension=3):
    """Turned, with those standard deviations along their axes."""
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.normal(size=(count, dimension, dimension)))[0]
    return (axes * np.square(spreads)) @ axes.transpose(0, 2, 1)


SHAPES = {
    "round": (1.0, 1.0, 1.0),
    "a plane": (1e-4, 1.0, 1.0),
    "a needle": (1e-3, 1e-3, 1.0),
    "three sizes": (0.1, 0.4, 1.0),
    "flat": (0.0, 0.5, 1.0),
}


@pytest.mark.parametrize("unit", [1.0, 1e-150, 1e150])
@pytest.mark.parametrize("shape", SHAPES)
def test_axes_and_variances_are_those_of_the_matrix(shape, unit):
    matrices = symmetric(1, SHAPES[shape]) * unit
    variances, axes = principal_axes(matrices)
    assert (np.diff(variances, axis=1) >= 0.0).all()
    np.testing.assert_allclose(variances / unit, np.linalg.eigvalsh(matrices / unit), rtol=0, atol=4e-15)
    np.testing.assert_allclose(axes.transpose(0, 2, 1) @ axes, np.tile(np.eye(3), (200, 1, 1)), rtol=0, atol=1e-14)
    made = (axes * variances[:, None, :]) @ axes.transpose(0, 2, 1)
    np.testing.assert_allclose(made / unit, matrices / unit, rtol=0, atol=4e-15)
    np.testing.assert_array_equal(principal_variances(matrices), variances)


def test_matrices_that_are_no_covariances_and_those_along_the_axes():
    rng = np.random.default_rng(2)
    matrices = rng.normal(size=(500, 3, 3))
    matrices += matrices.transpose(0, 2, 1)
    np.testing.assert_allclose(principal_variances(matrices), np.linalg.eigvalsh(matrices), rtol=0, atol=2e-14)
    diagonal = np.array([np.diag(order) for order in ([3.0, 1.0, 2.0], [2.0, 3.0, 1.0], [1.0, 2.0, 3.0], [0.0] * 3)])
    variances, axes = principal_axes(diagonal)
    np.testing.assert_array_equal(variances, np.sort(diagonal.diagonal(axis1=1, axis2=2), axis=1))
    np.testing.assert_array_equal((axes * variances[:, None, :]) @ axes.transpose(0, 2, 1), diagonal)


def test_in_the_plane():
    matrices = symmetric(3, (0.2, 1.0), dimension=2)
    variances, axes = principal_axes(matrices)
    np.testing.assert_allclose((axes * variances[:, None, :]) @ axes.transpose(0, 2, 1), matrices, rtol=0, atol=1e-14)
    np.testing.assert_allclose(principal_variances(matrices), variances, rtol=0, atol=1e-14)


@pytest.mark.parametrize("dimension", [2, 3])
def test_scatter_is_the_weighted_covariance_of_what_is_near(dimension):
    rng = np.random.default_rng(4)
    points, weights = rng.normal(size=(50, dimension)) + 3.0, rng.uniform(1.0, 4.0, 50)
    rows = np.array([rng.choice(50, 8, replace=False) for _ in range(20)])
    squares = rng.uniform(0.0, 2.0, rows.shape)
    scatters, counts = scatter_among(points, rows, weights=weights, squares=squares, reach_sq=1.0)
    for scatter, count, row, square in zip(scatters, counts, rows, squares, strict=True):
        near = row[square <= 1.0]
        assert count == len(near)
        expected = np.cov(points[near].T, aweights=weights[near], ddof=0) if len(near) else np.zeros((dimension,) * 2)
        np.testing.assert_allclose(scatter, expected, rtol=0, atol=1e-13)
    everything = scatter_among(points, rows)[0]
    np.testing.assert_allclose(everything[0], np.cov(points[rows[0]].T, ddof=0), rtol=0, atol=1e-13)


def test_scatter_keeps_its_digits_far_from_the_origin():
    far = np.random.default_rng(5).normal(size=(40, 3)) + 1e6
    rows = np.arange(40).reshape(2, 20)
    for scatter, row in zip(scatter_among(far, rows)[0], rows, strict=True):
        np.testing.assert_allclose(scatter, np.cov((far[row] - 1e6).T, ddof=0), rtol=0, atol=1e-13)
