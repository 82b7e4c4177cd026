"""Dense clouds with fewer points: what lies closer together than any σ can tell apart is one component.

Until σ has come down to SIGMA_FLOOR a Gaussian is as wide as 1.6 % of the radius at least, however many
points there are. Points within a cell much smaller than that, and about as certain, are merged into one of their
weight. The number of components is then that of the cells the surface runs through, and a cloud of a million points
costs little more than one of fifty thousand.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.grouping import Groups
from adagmm_o3d.mixtures.mixture import Mixture

# No part of a cloud that decides between ends resolves its shape better than this σ: a standard deviation of 1.6 % of
# the radius.
SIGMA_FLOOR = 2.5e-4
# Smaller clouds have hardly two points in a cell.
CONDENSED_FROM = 20_000
# Nor is it worth it where more than this share of the points would be left.
MOST_LEFT = 0.6
# The edge of a cell in radii: points spread evenly over it have a tenth of the variance of a good point at the floor.
CELL = math.sqrt(12.0 * 0.1 * SIGMA_FLOOR)
# Merged points differ in variance by less than a factor of two. Points more certain than this keep to themselves (the
# unit is the variance of a good point): their Gaussians are finer than the cells.
LEAST_VARIANCE = 0.5
# A cell's number: its place along three axes, 20 bits each, and the octave of the variance.
AXIS_BITS, OCTAVES = 20, 16


def condense(mixture: Mixture) -> Mixture:
    """The normalised mixture with at most one component a cell and octave of variance; itself where that saves little.

    A component has the mean of its points, their mean covariance, and the sum of their weights.
    """
    if mixture.on_device or len(mixture) < CONDENSED_FROM:
        return mixture
    condensed = mixture.kept_for("condensed", lambda: _condensed(mixture))
    return mixture if condensed is None else condensed


def _condensed(mixture: Mixture) -> Mixture | None:
    """None where that saves little."""
    cells = Groups(_cells(mixture), mixture.weights)
    if len(cells) > MOST_LEFT * len(mixture):
        return None
    if mixture.isotropic:
        covariances = cells.means(mixture.covariances[:, 0, 0])[:, None, None] * np.eye(3)
        if mixture.dimension == 2:
            covariances[:, 2, 2] = 1.0
    else:
        covariances = cells.means(mixture.covariances)
    points = cells.means(mixture.points)
    return Mixture(points, covariances, cells.total, mixture.dimension, mixture.isotropic, np.full(len(points), True))


def _cells(mixture: Mixture) -> NDArray[np.int64]:
    """(n,) the number of each point's cell; one of its own for points that keep to themselves."""
    half = 1 << (AXIS_BITS - 1)
    places = np.floor(mixture.points / CELL)
    apart = (np.abs(places) >= half).any(axis=1) | (mixture.variances < LEAST_VARIANCE)
    octaves = np.clip(np.floor(np.log2(mixture.variances)) + 1.0, 0, OCTAVES - 1).astype(np.int64)
    places = np.where(apart[:, None], 0.0, places).astype(np.int64) + half
    cells = octaves
    for axis in range(3):
        cells = (cells << AXIS_BITS) | places[:, axis]
    return np.where(apart, -1 - np.arange(len(mixture)), cells)
