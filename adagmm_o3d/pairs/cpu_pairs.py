"""Two mixtures laid out for the kernels, and one pass over all their pairs; the loop on top sees only this."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cpu.adaptive_rows import AdaptiveSource, AdaptiveTarget, adaptive_sums
from adagmm_o3d.kernels.cpu.convolved_pass import (
    Kind,
    PassSource,
    PassSums,
    PassTarget,
    Weighing,
    convolution_sums,
    pack,
)
from adagmm_o3d.kernels.cpu.convolved_rows import Hues
from adagmm_o3d.kernels.cpu.culling import CHUNK, CLUSTER
from adagmm_o3d.kernels.cpu.nearest import nearest_sq
from adagmm_o3d.kernels.cpu.ranges import run_in_ranges
from adagmm_o3d.kernels.cpu.tiles import Tiles, make_tiles, morton_order
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.layout import FACTOR, ISOTROPIC_FACTOR, MATRIX, TOTAL_ENERGY, TOTAL_SUMS, TOTAL_WEIGHT
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.pairs.protocol import PairSums, PosteriorSums

Float32 = NDArray[np.float32]

# Pairs whose weight is below 2**-CUT_BITS of the largest possible one may be left out, whole tiles at a time.
CUT_BITS = 24.0
# With fewer pairs than this for each thread, waking it costs more than it brings.
PAIRS_PER_THREAD = 200_000
# The column sums are kept apart for this many parts of the source, whatever the number of threads, and added in order.
BANDS = 16
# Coordinates of a colour.
HUES = 3


def amplitudes_and_bits(mixture: Mixture) -> tuple[Array, Array]:
    """(n,) heights of the components relative to the highest, and by how many powers of two a weight may fall."""
    amplitudes = mixture.variances ** (-0.5 * mixture.dimension)
    amplitudes /= amplitudes.max()
    # A pair weighs at most what its vaguer half allows: what is too vague reaches nowhere by itself.
    return amplitudes, np.maximum(0.0, CUT_BITS + np.log2(amplitudes))


class Side:
    """One mixture as the kernels want it: neighbours together, float32, one row per component."""

    def __init__(self, mixture: Mixture, isotropic: bool) -> None:
        amplitudes, bits = amplitudes_and_bits(mixture)
        self._rows = 1 if isotropic else 6
        self.order = morton_order(mixture.points, last=bits == 0.0)
        self.points = _float32(mixture.points[self.order].T)
        self.amplitudes = _float32((amplitudes * mixture.weights)[self.order])
        self.weights = mixture.weights[self.order] / mixture.weights.sum()
        self.weights32 = _float32(self.weights)
        self.variances = _float32(mixture.largest_variances[self.order] / LOG2_SCALE)
        self.bits = _float32(bits[self.order])

    @cached_property
    def tiles(self) -> Tiles:
        """The boxes that its points lie in."""
        return make_tiles(self.points, self.variances, self.bits)

    def precisions(self, mixture: Mixture) -> Float32:
        """(1 or 6, n) packed inverse covariances of its mixture, in powers of two."""
        return _float32(LOG2_SCALE * mixture.packed_precisions()[: self._rows, self.order])

    def covariances(self, mixture: Mixture) -> Float32:
        """(1 or 6, n) packed covariances of its mixture, in powers of two."""
        return _float32(mixture.packed_covariances()[: self._rows, self.order] / LOG2_SCALE)

    def restore(self, values: Array) -> Array:
        """Values in the kernels' order, put back into the mixture's."""
        restored = np.empty_like(values)
        restored[self.order] = values
        return restored


def side_of(mixture: Mixture, isotropic: bool) -> Side:
    """A mixture as the kernels want it, laid out once."""
    return mixture.kept_for(("side", isotropic), lambda: Side(mixture, isotropic))


class Matrices(NamedTuple):
    """Precisions or covariances of source and target in the kernels' order, (1 or 6, n) packed, in powers of two."""

    source: Float32
    target: Float32


class PairLoop:
    """The pairs of a source and a target mixture (normalised coordinates), evaluated by the CPU kernels.

    The mixtures are laid out for these with the first pass, which nobody may ask for.
    """

    def __init__(self, source: Mixture, target: Mixture) -> None:
        self._mixtures = source, target
        self._isotropic = source.isotropic and target.isotropic
        self._planar = source.dimension == 2
        self._chunks = -(-len(source) // CHUNK)
        self._bands = min(BANDS, -(-len(source) // CLUSTER))
        self._threads = max(1, min(numba.get_num_threads(), len(source) * len(target) // PAIRS_PER_THREAD))
        self._unit = LOG2_SCALE ** (1.0 if self._planar else 1.5)  # |Σ|^(-1/2) in powers of two

    def sums(self, pose: Array, source_sigma: float, target_sigma: float) -> PairSums:
        """The paper's E-step at `pose` (4, 4), the covariances of either side times its σ, summed up for the M-step."""
        source, target = self._source, self._target
        (matrices, target_matrices), scaled = self._precisions, self._scaled_precisions
        np.multiply(target_matrices, np.float32(1.0 / target_sigma), out=scaled)
        partials, row_weights = np.empty((self._chunks, TOTAL_SUMS)), np.empty(len(source.order))
        self._run(
            adaptive_sums,
            _packed_pose(pose),
            np.array([source_sigma, target_sigma], np.float32),
            AdaptiveSource(source.points, matrices, source.amplitudes, source.variances, source.bits),
            AdaptiveTarget(target.points, scaled, target.amplitudes),
            target.tiles,
            self._isotropic,
            partials,
            row_weights,
        )
        return PairSums(total_of(partials), source.restore(row_weights))

    def posterior_sums(
        self, pose: Array, sigma: float, uniform: float, mutuality: float = 0.0, colour: ColourModel | None = None
    ) -> PosteriorSums:
        """The E-step on convolved Gaussians at `pose` (4, 4), summed up for the M-step.

        uniform : density of the points without a partner, in units of (2π)^(-D/2) per normalised volume.
        mutuality : 0 to 1/2. A pair has two posteriors, seen from the source (the share it has of the density at the
            source point) and seen from the target. Its weight is their weighted geometric mean, the second to the power
            of `mutuality`: 1/2 treats both clouds alike. Above 0 it takes a pass over the pairs of its own.
        colour : what is believed of the colours that both mixtures have; None for geometry alone.
        """
        target = self._target
        packed, n = self._packed(colour), len(target.order)
        if colour is not None:
            # The kernels leave out by how much any two points' colours agree.
            uniform = uniform * colour.expected
        factors = packed[ISOTROPIC_FACTOR if self._isotropic else FACTOR, :n]
        factors[:] = 1.0
        columns = None
        if mutuality > 0.0:
            columns = self._column_densities(pose, sigma, packed, colour)
            factors[:] = (uniform / (columns + uniform)) ** mutuality
        sums = self._convolve(pose, sigma, packed, colour, Weighing(uniform * self._unit, mutuality))
        densities = sums.densities / self._unit

        def find_column_densities() -> Array:
            found = self._column_densities(pose, sigma, self._packed(colour), colour) if columns is None else columns
            return target.restore(found if colour is None else found / colour.expected)

        return PosteriorSums(
            total_of(sums.totals), self._source.restore(densities / (densities + uniform)), find_column_densities
        )

    def nearest_sq(self, pose: Array) -> Array:
        """(M,) squared distance of each source point at `pose` to its nearest target point."""
        nearest = np.empty(len(self._source.order))
        self._run(
            nearest_sq,
            _packed_pose(pose),
            self._source.points,
            self._target.points,
            self._target.tiles,
            nearest,
        )
        return self._source.restore(nearest)

    @cached_property
    def _source(self) -> Side:
        return side_of(self._mixtures[0], self._isotropic)

    @cached_property
    def _target(self) -> Side:
        return side_of(self._mixtures[1], self._isotropic)

    @cached_property
    def _precisions(self) -> Matrices:
        return self._laid_out("precisions", Side.precisions)

    @cached_property
    def _scaled_precisions(self) -> Float32:
        """Room for the target's at some σ."""
        return np.empty_like(self._precisions.target)

    @cached_property
    def _covariances(self) -> Matrices:
        return self._laid_out("covariances", Side.covariances)

    def _laid_out(self, what: str, lay_out: Callable[[Side, Mixture], Float32]) -> Matrices:
        """The matrices of both sides, each kept by its mixture."""
        source, target = (
            mixture.kept_for((what, self._isotropic), partial(lay_out, side, mixture))
            for side, mixture in zip((self._source, self._target), self._mixtures, strict=True)
        )
        return Matrices(source, target)

    @cached_property
    def _plain(self) -> Float32:
        """The packed target with room for its covariances at some σ."""
        return pack(self._target.points, self._target.weights32, len(self._covariances.target))

    @cached_property
    def _coloured(self) -> Float32:
        """The same with room for colours."""
        return pack(self._target.points, self._target.weights32, len(self._covariances.target), HUES)

    def _packed(self, colour: ColourModel | None) -> Float32:
        if colour is None:
            return self._plain
        self._coloured[-HUES:, : len(self._target.order)] = self._hues(colour, of_source=False)
        return self._coloured

    def _hues(self, colour: ColourModel, *, of_source: bool) -> Float32:
        """(3, n) colours of one side in the kernels' order, see `ColourModel.hues`."""
        mixture, side = (self._mixtures[0], self._source) if of_source else (self._mixtures[1], self._target)
        assert mixture.colours is not None
        return colour.hues(mixture.colours[side.order], of_source=of_source)

    def _column_densities(self, pose: Array, sigma: float, packed: Float32, colour: ColourModel | None) -> Array:
        """(N,) density of the source at the target points, in the kernels' order."""
        columns = self._convolve(pose, sigma, packed, colour, None).columns
        sums = np.add.reduce(columns[:, : len(self._target.order)], axis=0, dtype=np.float64)
        return sums / (self._unit * self._target.weights)

    def _convolve(
        self,
        pose: Array,
        sigma: float,
        packed: Float32,
        colour: ColourModel | None,
        weighing: Weighing | None,
    ) -> PassSums:
        """The sums of all bands, or where nothing is weighed the densities at the points of either side."""
        source, target, scale = self._source, self._target, np.float32(sigma)
        matrices, target_matrices = self._covariances
        np.multiply(target_matrices, scale, out=packed[MATRIX : MATRIX + len(matrices), : len(target.order)])
        sums = PassSums(
            np.empty((self._bands, 0 if weighing is not None else packed.shape[1]), np.float32),
            np.empty((self._bands, TOTAL_SUMS)),
            np.empty(len(source.order)),
        )
        arguments = (
            PassSource(
                _packed_pose(pose),
                source.points,
                matrices * scale,
                source.weights,
                source.weights32,
                source.variances * scale,
                source.bits,
            ),
            None if colour is None else Hues(self._hues(colour, of_source=True), colour.cap),
            PassTarget(packed, target.variances * scale, target.bits, target.tiles.at(scale)),
            Kind(self._planar, self._isotropic, densities_only=weighing is None),
            weighing or Weighing(0.0, 0.0),
            sums,
        )

        def run(first: int, last: int) -> None:
            convolution_sums(first, last, *arguments)

        run_in_ranges(convolution_sums, run, self._bands, self._threads)
        return sums

    def _run(self, kernel: Callable[..., None], *args: Any) -> None:
        threads = numba.get_num_threads()
        numba.set_num_threads(min(threads, self._threads))
        try:
            kernel(*args)
        finally:
            numba.set_num_threads(threads)


def total_of(partials: Array) -> Array:
    """The partial sums, added in order and out of powers of two."""
    total = np.add.reduce(partials, axis=0)
    total[:TOTAL_WEIGHT] /= LOG2_SCALE
    total[TOTAL_ENERGY] /= LOG2_SCALE
    return total


def _packed_pose(pose: Array) -> Float32:
    return np.ascontiguousarray(pose[:3], np.float32).ravel()


def _float32(array: Array) -> Float32:
    return np.ascontiguousarray(array, np.float32)
