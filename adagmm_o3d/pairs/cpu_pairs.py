"""Two mixtures laid out for the kernels, and one pass over all their pairs; the loop on top sees only this."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cpu.adaptive_rows import adaptive_sums
from adagmm_o3d.kernels.cpu.convolved_pass import Kind, PassSource, PassTarget, convolution_sums, pack
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
        self._no_columns = np.empty((self._bands, 0), np.float32)

    def sums(self, pose: Array, source_sigma: float, target_sigma: float) -> PairSums:
        """The paper's E-step at `pose` (4, 4), the covariances of either side times its σ, summed up for the M-step."""
        source, target = self._source, self._target
        matrices, target_matrices, scaled = self._precisions
        np.multiply(target_matrices, np.float32(1.0 / target_sigma), out=scaled)
        partials, row_weights = np.empty((self._chunks, TOTAL_SUMS)), np.empty(len(source.order))
        self._run(
            adaptive_sums,
            _packed_pose(pose),
            np.array([source_sigma, target_sigma], np.float32),
            (source.points, matrices, source.amplitudes, source.variances, source.bits),
            (target.points, scaled, target.amplitudes),
            target.tiles,
            self._isotropic,
            0,
            self._chunks,
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
        partials = np.empty((self._bands, TOTAL_SUMS))
        densities = self._convolve(pose, sigma, packed, colour, uniform, mutuality, self._no_columns, partials)

        def find_column_densities() -> Array:
            found = self._column_densities(pose, sigma, self._packed(colour), colour) if columns is None else columns
            return target.restore(found if colour is None else found / colour.expected)

        return PosteriorSums(
            total_of(partials), self._source.restore(densities / (densities + uniform)), find_column_densities
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
            0,
            self._chunks,
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
    def _precisions(self) -> tuple[Float32, Float32, Float32]:
        """Precisions of source and target, and room for the target's at some σ."""
        source, matrices = self._laid_out("precisions", Side.precisions)
        return source, matrices, np.empty_like(matrices)

    @cached_property
    def _convolved(self) -> tuple[Float32, Float32]:
        """Covariances of source and target."""
        return self._laid_out("covariances", Side.covariances)

    def _laid_out(self, what: str, lay_out: Callable[[Side, Mixture], Float32]) -> tuple[Float32, Float32]:
        """The matrices of source and target, which each of the mixtures keeps."""
        source, target = (
            mixture.kept_for((what, self._isotropic), partial(lay_out, side, mixture))
            for side, mixture in zip((self._source, self._target), self._mixtures, strict=True)
        )
        return source, target

    @cached_property
    def _plain(self) -> Float32:
        """The packed target with room for its covariances at some σ."""
        return pack(self._target.points, self._target.weights32, len(self._convolved[1]))

    @cached_property
    def _coloured(self) -> Float32:
        """The same with room for colours."""
        return pack(self._target.points, self._target.weights32, len(self._convolved[1]), HUES)

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
        columns = np.empty((self._bands, packed.shape[1]), np.float32)
        self._convolve(pose, sigma, packed, colour, 0.0, 0.0, columns, np.empty((self._bands, TOTAL_SUMS)))
        sums = np.add.reduce(columns[:, : len(self._target.order)], axis=0, dtype=np.float64)
        return sums / (self._unit * self._target.weights)

    def _convolve(
        self,
        pose: Array,
        sigma: float,
        packed: Float32,
        colour: ColourModel | None,
        uniform: float,
        mutuality: float,
        columns: Float32,
        partials: Array,
    ) -> Array:
        """Fill `columns` where there are any, otherwise `partials`; (M,) density of the target at the source points."""
        source, target, scale = self._source, self._target, np.float32(sigma)
        matrices, target_matrices = self._convolved
        np.multiply(target_matrices, scale, out=packed[MATRIX : MATRIX + len(matrices), : len(target.order)])
        densities = np.empty(len(source.order))
        arguments = (
            _packed_pose(pose),
            PassSource(
                source.points,
                matrices * scale,
                source.weights,
                source.weights32,
                source.variances * scale,
                source.bits,
            ),
            None if colour is None else (self._hues(colour, of_source=True), colour.cap),
            PassTarget(packed, target.variances * scale, target.bits),
            target.tiles.at(scale),
            Kind(self._planar, self._isotropic, columns is not self._no_columns),
            uniform * self._unit,
            mutuality,
            columns,
            partials,
            densities,
        )

        def run(first: int, last: int) -> None:
            convolution_sums(first, last, *arguments)

        run_in_ranges(convolution_sums, run, self._bands, self._threads)
        return densities / self._unit

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
