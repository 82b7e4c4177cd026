"""Clouds with fewer points: what lies closer together than a scale σ can tell apart is one component.

Points of a cell that are about as certain become one component with their mean, their mean covariance and their own
scatter about it. The scatter counts OVERLAP times: then neighbouring components overlap, their sum is as smooth as the
surface that the points are on, and it is thin where they are. Points that carry no covariances of a surface get one
that way.

A dense cloud is looked at so from the start. Its cells count alike however many points are in them, as how often a
sensor hits a surface says nothing of how much it tells: a spinning LiDAR's rings would be registered to each other.
Any other cloud is condensed where σ is so wide that a point would meet very many others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.grouping import CELL, DENSE_FROM, FEWEST, MOST_KINDS, MOST_LEFT, Groups, cell_numbers, in_few_places
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.principal import principal_axes

# No part of a cloud that decides between ends resolves its shape better than this σ: a standard deviation of 1.6 % of
# the radius.
SIGMA_FLOOR = 2.5e-4
# How often the scatter of a cell counts. A uniform one then has a standard deviation of 0.58 edges.
OVERLAP = 4.0
# A cell counts for so many points at most; fewer may be one stray point. Where more count, what is near a LiDAR, its
# rings with it, counts more, and pulls back along the way: by 0.6 mm a metre with two points, by 0.9 mm with four.
# Where fewer do, noisy beams are averaged less: scans of these end a third farther off.
FULL = 4.0
# The last σ of a dense cloud, in squared edges and times how much more its components vary along their widest axis than
# all around: surfaces of covariances like those of GICP are then one edge wide. Below, a LiDAR's rings, which lie
# farther apart than cells do, would be registered to each other. Others are held apart by the scatter in their cells.
LAST, LEAST_ELONGATION = 0.0108, 2.5
# Below SIGMA_FLOOR the components of a dense cloud are flatter: their widths relative to the widest one are to this
# power, none below that share. Where on a surface a sensor hits it is of its own making, and draws one scan to another
# along it; the surface itself does not. Simulated scans of wide beams end half as far off, drives drift less.
FLATTER, LEAST_SHARE = 1.2, 1e-9
# A point that would meet more than so many components meets condensed ones, of which each has this share of its
# standard deviation for an edge.
MOST_MET, EDGE = 1500, 1.67
# Squared Mahalanobis distance to which a pair is looked at: its weight is 2**-24 there.
REACH = 33.0
# Octaves of the variance that are told apart, from 2**-FINE_OCTAVES on.
FINE_OCTAVES = 8


@dataclass(frozen=True)
class Cells:
    """The components that the points of a mixture's cells make.

    points (n, 3).   covariances (n, 3, 3) the points' mean.   scatters (n, 3, 3) of the points about their mean.
    weights (n,).   colours (n, 3) the mean, or None.
    """

    points: Array
    covariances: Array
    scatters: Array
    weights: Array
    dimension: int
    colours: Array | None = None

    def at(self, sigma: float) -> Mixture:
        """The mixture with covariances that, times `sigma`, have the scatter in them."""
        covariances = self.covariances + (OVERLAP / sigma) * self.scatters
        if sigma < SIGMA_FLOOR and self.dimension == 3:
            covariances = _flatter(covariances)
        kept = np.full(len(self.points), True)
        return Mixture(
            self.points, covariances, self.weights, self.dimension, isotropic=False, kept=kept, colours=self.colours
        )


class Condensed:
    """A normalised mixture with as many components as a scale asks for.

    last : the least σ that the cells of a dense cloud tell apart, 0 of any other.
    """

    def __init__(self, mixture: Mixture) -> None:
        self.whole = mixture
        self._cells, self.last = mixture.kept_for("even cells", lambda: _even_cells(mixture))

    @property
    def dense(self) -> bool:
        return self._cells is not None

    @property
    def searched(self) -> Mixture:
        """What stands for the points where ends are compared."""
        cells = self._cells
        return self.whole if cells is None else self.whole.kept_for("searched", lambda: cells.at(SIGMA_FLOOR))

    def at(self, begin: float, end: float) -> Mixture:
        """What stands for the points while σ falls from `begin` to `end`: no more than a point can afford to meet."""
        finest = self._bare
        if self.meets_many(begin):
            edges = EDGE * np.sqrt(end * _elongation(self.whole) * _octave_variances(finest))
            coarse = _make_cells(finest, edges, None if self._cells is None else self._cells.scatters)
            if coarse is not None:
                return coarse.at(end)
        return self.whole if self._cells is None else self._cells.at(end)

    def meets_many(self, sigma: float) -> bool:
        """Whether a point would meet more than MOST_MET components at `sigma`, were they spread over a sphere.

        Never on a GPU, which can afford them.
        """
        if self.whole.on_device:
            return False
        return len(self._bare) * min(1.0, 2.0 * REACH * sigma * self._typical_largest / 4.0) > MOST_MET

    @cached_property
    def _bare(self) -> Mixture:
        """The finest components without the scatter of their points."""
        cells = self._cells
        if cells is None:
            return self.whole
        kept = np.full(len(cells.points), True)
        isotropic = self.whole.isotropic
        return Mixture(
            cells.points, cells.covariances, cells.weights, cells.dimension, isotropic, kept, colours=cells.colours
        )

    @cached_property
    def _typical_largest(self) -> float:
        return float(np.median(self._bare.largest_variances))


def _flatter(covariances: Array) -> Array:
    """(n, 3, 3) covariances as wide as these, but with the ratios of their axes to the power of FLATTER."""
    variances, axes = principal_axes(covariances)
    widest = variances[:, 2:]
    shares = np.maximum(variances / widest, LEAST_SHARE) ** FLATTER
    return (axes * (widest * shares)[:, None, :]) @ axes.transpose(0, 2, 1)


def _even_cells(mixture: Mixture) -> tuple[Cells | None, float]:
    """The cells of a dense cloud and the least σ that they tell apart."""
    if mixture.on_device or len(mixture) < DENSE_FROM:
        return None, 0.0
    edge = CELL
    while (cells := _make_cells(mixture, np.full(len(mixture), edge))) is not None and len(cells.points) < FEWEST:
        if edge == CELL and in_few_places(mixture.points):
            return None, 0.0
        edge *= 0.5
    if cells is None:
        return None, 0.0
    weights = np.minimum(cells.weights, FULL * np.median(mixture.weights))
    return replace(cells, weights=weights), LAST * edge**2 * max(_elongation(mixture), LEAST_ELONGATION)


def _elongation(mixture: Mixture) -> float:
    """How much more a component varies along its widest axis than all around."""
    return float(np.median(mixture.largest_variances / mixture.variances))


def _octaves(mixture: Mixture) -> NDArray[np.int64]:
    octaves = np.floor(np.log2(mixture.variances)) + FINE_OCTAVES
    return np.clip(octaves, 0, MOST_KINDS - 1).astype(np.int64)


def _octave_variances(mixture: Mixture) -> Array:
    """(n,) the least variance of each component's octave."""
    return np.exp2(_octaves(mixture) - float(FINE_OCTAVES))


def _make_cells(mixture: Mixture, edges: Array, scatters: Array | None = None) -> Cells | None:
    """The cells of edges (n,) that the points lie in, which may have scatters (n, 3, 3) of their own; None where hardly
    two are in a cell."""
    groups = Groups(cell_numbers(mixture.points, edges, _octaves(mixture)), mixture.weights)
    if len(groups) > MOST_LEFT * len(mixture):
        return None
    points = groups.means(mixture.points)
    offsets = mixture.points - groups.each(points)
    between = offsets[:, :, None] * offsets[:, None, :]
    scatters = groups.means(between if scatters is None else between + scatters)
    if mixture.isotropic:
        covariances = groups.means(mixture.covariances[:, 0, 0])[:, None, None] * np.eye(3)
        if mixture.dimension == 2:
            covariances[:, 2, 2] = 1.0
    else:
        covariances = groups.means(mixture.covariances)
    colours = None if mixture.colours is None else groups.means(mixture.colours)
    return Cells(points, covariances, scatters, groups.total, mixture.dimension, colours)
