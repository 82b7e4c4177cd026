"""The density of points without a partner, against the surface that it stands for."""

import math

import numpy as np
import pytest

from adagmm_o3d.em.unmatched import AREA, uniform_density


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("sigma", [1e-4, 0.02, 0.3])
def test_it_is_that_of_a_surface_as_thick_as_the_mixtures(dimension, sigma):
    """Unit weight spread over AREA, across it the convolution of two normal densities of variance σ at its middle."""
    across = 1.0 / math.sqrt(2.0 * math.pi * 2.0 * sigma)
    share = 0.2
    expected = across / AREA[dimension] * share / (1.0 - share) * (2.0 * math.pi) ** (0.5 * dimension)
    assert uniform_density(share, sigma, dimension) == pytest.approx(expected, rel=1e-12)


def test_a_point_is_let_go_sooner_where_the_mixtures_are_narrow():
    """The distance from a plane of points at which having a partner and having none are as likely, in thicknesses."""
    sigmas = np.array([1e-4, 1e-2, 0.3])
    sheet = 1.0 / (4.0 * math.pi)  # weight per area of a cloud as large as the unit sphere
    at_surface = sheet / np.sqrt(4.0 * math.pi * sigmas) * (2.0 * math.pi) ** 1.5
    density = np.array([uniform_density(0.5, sigma, 3) for sigma in sigmas])
    reach = np.sqrt(2.0 * np.log(at_surface / density))
    np.testing.assert_allclose(reach, reach[0], rtol=1e-12, atol=0)
    assert 1.0 < reach[0] < 3.0
