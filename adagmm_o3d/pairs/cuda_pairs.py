"""Two mixtures on the GPU, and one pass over all their pairs: the twin of `cpu_pairs.PairLoop`.

Points and matrices are brought into tiles once. A pass sends a pose and a few numbers, and gets TOTAL_SUMS or a few
more back; what there is for every point stays on the device until it is read.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cuda import (
    adaptive_rows,
    convolved_columns,
    convolved_rows,
    moving,
    nearest,
    reductions,
    scores,
)
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda
from adagmm_o3d.kernels.cuda.held import Buffers, Held, upload
from adagmm_o3d.kernels.cuda.tiles import tiled
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.layout import TOTAL_SUMS
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.pairs.cpu_pairs import total_of
from adagmm_o3d.pairs.cuda_sides import make_side
from adagmm_o3d.pairs.protocol import PairSums, PosteriorSums

# Blocks that fill a large GPU; few tiles on one side are made up for by cutting the other into up to MOST_SHARES.
WANTED_BLOCKS = 2048
MOST_SHARES = 32


class _Kernels(NamedTuple):
    """The kernels for one kind of matrices."""

    move: Any
    adaptive_rows: Any
    convolved_rows: Any
    convolved_columns: Any
    coloured_rows: Any
    coloured_columns: Any
    reduce_adaptive: Any
    scores_of_source: Any
    scores_of_target: Any
    coloured_scores_of_source: Any
    coloured_scores_of_target: Any


class Hues(NamedTuple):
    """Colours of source and target, (tiles, 3, TILE) float32 on the device, where their distance is capped, and whether
    they count at all."""

    source: Any
    target: Any
    cap: np.float32
    count: bool


ISOTROPIC = _Kernels(
    moving.move_isotropic,
    adaptive_rows.adaptive_rows_isotropic,
    convolved_rows.convolved_rows_isotropic,
    convolved_columns.convolved_columns_isotropic,
    convolved_rows.coloured_rows_isotropic,
    convolved_columns.coloured_columns_isotropic,
    reductions.reduce_adaptive_isotropic,
    scores.score_sums_of_source_isotropic,
    scores.score_sums_of_target_isotropic,
    scores.coloured_sums_of_source_isotropic,
    scores.coloured_sums_of_target_isotropic,
)
FULL = _Kernels(
    moving.move_full,
    adaptive_rows.adaptive_rows_full,
    convolved_rows.convolved_rows_full,
    convolved_columns.convolved_columns_full,
    convolved_rows.coloured_rows_full,
    convolved_columns.coloured_columns_full,
    reductions.reduce_adaptive_full,
    scores.score_sums_of_source,
    scores.score_sums_of_target,
    scores.coloured_sums_of_source,
    scores.coloured_sums_of_target,
)


class CudaPairSums(PairSums):
    """`PairSums` whose row_weights are read from the device when they are asked for."""

    def __init__(self, total: Array, rows: Held) -> None:
        self.__dict__.update(total=total_of(total[None]), _rows=rows)

    @cached_property
    def row_weights(self) -> Array:  # type: ignore[override]
        return self.__dict__["_rows"].read()


class CudaPosteriorSums(PosteriorSums):
    """`PosteriorSums` whose row_weights are read from the device when they are asked for."""

    def __init__(self, total: Array, rows: Held, find_columns: Callable[[], Array]) -> None:
        self.__dict__.update(total=total_of(total[None]), find_column_densities=find_columns, _rows=rows)

    @cached_property
    def row_weights(self) -> Array:  # type: ignore[override]
        return self.__dict__["_rows"].read()


class CudaPairLoop:
    """The pairs of a source and a target mixture (normalised coordinates), evaluated on the current CUDA device."""

    def __init__(self, source: Mixture, target: Mixture) -> None:
        self._mixtures = source, target
        isotropic = source.isotropic and target.isotropic
        self._kernels = ISOTROPIC if isotropic else FULL
        self._planar = source.dimension == 2
        self._unit = LOG2_SCALE ** (1.0 if self._planar else 1.5)  # |Σ|^(-1/2) in powers of two
        self._source, self._target = make_side(source, isotropic), make_side(target, isotropic)
        self._source_boxes, self._target_boxes = self._source.boxes, self._target.boxes
        self._source_tiles, self._target_tiles = self._source_boxes.shape[0], self._target_boxes.shape[0]
        self._row_shares = _shares(self._source_tiles, self._target_tiles)
        self._column_shares = _shares(self._target_tiles, self._source_tiles)
        m, n = self._source_tiles * TILE, self._target_tiles * TILE
        self._moved = cuda.device_array((self._source_tiles, 5 if isotropic else 10, TILE), np.float32)
        self._moved_boxes = cuda.device_array(self._source_boxes.shape, np.float32)
        self._rows = cuda.device_array((self._row_shares, adaptive_rows.ROWS, m), np.float64)
        self._column_parts = cuda.device_array((self._column_shares, n), np.float64)
        self._row_partials = cuda.device_array((TOTAL_SUMS, self._source_tiles), np.float64)
        self._totals = cuda.device_array(TOTAL_SUMS, np.float64)
        self._densities32 = cuda.device_array((self._target_tiles, TILE), np.float32)
        self._row_buffers = Buffers(m, self._source.restore, len(source))
        self._column_buffers = Buffers(n, self._target.restore, len(target))

    def sums(self, pose: Array, source_sigma: float, target_sigma: float) -> CudaPairSums:
        """As `PairLoop.sums`."""
        source, _, amplitudes = self._precisions
        self._move(pose, np.float32(1.0 / source_sigma), False, source)
        self.launch_adaptive_rows(source_sigma, target_sigma)
        weights = self._row_buffers.take()
        self._kernels.reduce_adaptive[self._source_tiles, TILE](
            self._moved, self._rows, amplitudes, weights.buffer, self._row_partials
        )
        return CudaPairSums(self._add_up(), weights)

    def posterior_sums(
        self, pose: Array, sigma: float, uniform: float, mutuality: float = 0.0, colour: ColourModel | None = None
    ) -> CudaPosteriorSums:
        """As `PairLoop.posterior_sums`.

        The target's densities take a pass over all pairs of their own, before that for the source where mutuality needs
        them, else when somebody asks.
        """
        source, _, source_weights = self._covariances
        self._move(pose, np.float32(sigma), self._planar, source)
        hues = self._hues(colour)
        expected = 1.0 if colour is None else colour.expected
        # The kernels leave out by how much any two points' colours agree.
        uniform = uniform * expected
        columns = self._reduced_columns(sigma, hues) if mutuality > 0.0 else None
        self.launch_convolved_rows(sigma, uniform, mutuality, hues)
        posteriors = self._row_buffers.take()
        reductions.reduce_convolved[self._source_tiles, TILE](
            self._moved,
            self._rows,
            source_weights,
            float(uniform * self._unit),
            float(mutuality),
            posteriors.buffer,
            self._row_partials,
        )

        def find_columns() -> Array:
            if columns is not None:
                return columns.read() / expected
            self._move(pose, np.float32(sigma), self._planar, source)
            return self._reduced_columns(sigma, hues).read() / expected

        return CudaPosteriorSums(self._add_up(), posteriors, find_columns)

    def _hues(self, colour: ColourModel | None) -> Hues:
        """The colours of both mixtures on the device; of none a placeholder."""
        if colour is None:
            return self._no_hues
        source, target = (
            upload(tiled(colour.hues(_colours_of(mixture)[side.order], of_source=side is self._source)))
            for mixture, side in zip(self._mixtures, (self._source, self._target), strict=True)
        )
        return Hues(source, target, colour.cap, True)

    @cached_property
    def _no_hues(self) -> Hues:
        none = cuda.device_array((1, 3, TILE), np.float32)
        return Hues(none, none, np.float32(0.0), False)

    def _reduced_columns(self, sigma: float, hues: Hues) -> Held:
        """The column densities, with the source where it was last moved to."""
        self.launch_convolved_columns(sigma, hues)
        columns = self._column_buffers.take()
        reductions.reduce_columns[self._target_tiles, TILE](
            self._column_parts, self._unit, columns.buffer, self._densities32
        )
        return columns

    def nearest_sq(self, pose: Array) -> Array:
        """As `PairLoop.nearest_sq`."""
        source, target, _ = self._precisions
        self._move(pose, np.float32(1.0), False, source)
        nearest.nearest_sq[(self._source_tiles, self._row_shares), TILE](
            self._moved, self._moved_boxes, target, self._target_boxes, self._nearest_parts
        )
        reductions.reduce_nearest[self._source_tiles, TILE](self._nearest_parts, self._nearest)
        distances = self._nearest.copy_to_host()[: len(self._source.order)]
        return self._source.restore(distances.astype(np.float64))

    def score_sums(
        self,
        pose: Array,
        sigma: float,
        own: NDArray[np.float32],
        own_is_source: bool,
        weights: Array,
        shares: Array,
        cut: float,
        colour: ColourModel | None = None,
        own_colours: Array | None = None,
    ) -> Array:
        """(K, POINT_SUMS) as `kernels.cpu.scores`, but for the weights of the points themselves.

        own : (POINT, K) points of the source at `pose`, or of the target, see `scores`.   weights, shares : (n,) of all
        points of the other side, see there.   own_colours : (K, 3), with a model of the colours of both.
        """
        source, target, _ = self._covariances
        kernels, hues = self._kernels, self._hues(colour)
        if own_is_source:
            kernel = kernels.coloured_scores_of_source if hues.count else kernels.scores_of_source
            other, side, other_hues = target, self._target, hues.target
            other_boxes, scale = self._target_boxes, sigma * LOG2_SCALE
        else:
            self._move(pose, np.float32(sigma), False, source)
            kernel = kernels.coloured_scores_of_target if hues.count else kernels.scores_of_target
            other, side, other_hues = self._moved, self._source, hues.source
            other_boxes, scale = self._moved_boxes, LOG2_SCALE
        own_hues, expected = np.zeros((1, 3, 1), np.float32), 1.0
        if colour is not None:
            assert own_colours is not None
            own_hues, expected = colour.hues(own_colours, of_source=own_is_source)[None], colour.expected
        sums = cuda.device_array((scores.SUMS if own_is_source else scores.CURVATURE, own.shape[1]), np.float64)
        kernel[own.shape[1], TILE](
            upload(own),
            other,
            other_boxes,
            np.float32(scale),
            np.float32(sigma * LOG2_SCALE),
            *(upload(tiled(values[side.order].astype(np.float32), 0.0)) for values in (weights, shares)),
            np.float32(cut),
            upload(own_hues),
            other_hues,
            hues.cap,
            sums,
        )
        # Each sum is of densities, and the kernels leave out by how much any two points' colours agree.
        return scores.unfolded(sums.copy_to_host()) / expected

    def launch_adaptive_rows(self, source_sigma: float, target_sigma: float) -> None:
        """The pairs of `sums` with the source where the last pass has moved it."""
        self._kernels.adaptive_rows[(self._source_tiles, self._row_shares), TILE](
            self._moved,
            self._moved_boxes,
            np.float32(source_sigma),
            self._precisions[1],
            self._target_boxes,
            np.float32(target_sigma),
            np.float32(1.0 / target_sigma),
            self._rows,
        )

    def launch_convolved_rows(self, sigma: float, uniform: float, mutuality: float, hues: Hues | None = None) -> None:
        """The pairs of `posterior_sums`, seen from the source, with the source where the last pass has moved it."""
        hues = hues or self._no_hues
        kernel = self._kernels.coloured_rows if hues.count else self._kernels.convolved_rows
        kernel[(self._source_tiles, self._row_shares), TILE](
            self._moved,
            self._moved_boxes,
            self._covariances[1],
            self._target_boxes,
            np.float32(sigma),
            self._planar,
            self._densities32,
            np.float32(uniform),
            np.float32(mutuality),
            hues.source,
            hues.target,
            hues.cap,
            self._rows,
        )

    def launch_convolved_columns(self, sigma: float, hues: Hues | None = None) -> None:
        """The same pairs, seen from the target."""
        hues = hues or self._no_hues
        kernel = self._kernels.coloured_columns if hues.count else self._kernels.convolved_columns
        kernel[(self._target_tiles, self._column_shares), TILE](
            self._covariances[1],
            self._target_boxes,
            np.float32(sigma),
            self._planar,
            self._moved,
            self._moved_boxes,
            hues.source,
            hues.target,
            hues.cap,
            self._column_parts,
        )

    def work_arrays(self) -> list[Any]:
        """Every array on the device that a pass fills before it reads it; a check may spoil them beforehand."""
        arrays = [self._moved, self._moved_boxes, self._rows, self._column_parts, self._row_partials]
        arrays += [self._densities32, self._totals, self._nearest_parts, self._nearest]
        return arrays + self._row_buffers.arrays() + self._column_buffers.arrays()

    @cached_property
    def _precisions(self) -> tuple[Any, Any, Any]:
        """Tiles of source and target with their precisions, and the source's amplitudes."""
        source, target = self._source, self._target
        return source.precision_tiles(), target.precision_tiles(), source.amplitude_tiles()

    @cached_property
    def _covariances(self) -> tuple[Any, Any, Any]:
        """Tiles of source and target with their covariances, and the source's weights."""
        return self._source.covariance_tiles(), self._target.covariance_tiles(), self._source.weight_tiles()

    @cached_property
    def _nearest_parts(self) -> Any:
        return cuda.device_array((self._row_shares, self._source_tiles * TILE), np.float32)

    @cached_property
    def _nearest(self) -> Any:
        return cuda.device_array(self._source_tiles * TILE, np.float32)

    def _move(self, pose: Array, scale: np.float32, planar: bool, source: Any) -> None:
        rows = tuple(np.float32(p) for p in pose[:3].ravel())
        self._kernels.move[self._source_tiles, TILE](
            rows, scale, planar, source, self._source_boxes, self._moved, self._moved_boxes
        )

    def _add_up(self) -> Array:
        reductions.total[TOTAL_SUMS, reductions.ADDERS](self._row_partials, self._totals)
        return self._totals.copy_to_host()


def _colours_of(mixture: Mixture) -> Array:
    assert mixture.colours is not None
    return mixture.colours


def _shares(own_tiles: int, other_tiles: int) -> int:
    """Into how many shares the other side is cut; the same on every device, and with it the order of all sums."""
    return max(1, min(WANTED_BLOCKS // own_tiles, MOST_SHARES, other_tiles))
