"""Two mixtures laid out for the kernels, and one pass over all their pairs; the loop on top sees only this."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ..mixture import Mixture
from . import cpu
from .layout import GRADIENT, HESSIAN, TOTAL_ENERGY, TOTAL_SUMS, TOTAL_WEIGHT
from .tiles import Tiles, make_tiles, morton_order

Array = NDArray[np.float64]

# exp(-q/2) = 2**-(LOG2_SCALE q): the kernels know only powers of two.
LOG2_SCALE = 0.5 / math.log(2.0)
# Pairs whose weight is below 2**-CUT_BITS of the largest possible one may be left out, whole tiles at a time.
CUT_BITS = 24.0
# With fewer pairs than this for each thread, waking it costs more than it brings.
PAIRS_PER_THREAD = 200_000
CHUNK = cpu.CLUSTER * cpu.CLUSTERS_PER_CHUNK
UPPER = np.triu_indices(6)


@dataclass(frozen=True)
class PairSums:
    """What one pass over all pairs leaves behind.

    hessian (6, 6) and gradient (6,) belong to ½ Q (the paper's Eq. 5), the weights held, at a left perturbation
    exp(δ)·T with δ = (ω, v). energy is Q, weight the sum of all weights, row_weights (M,) that of each source point.
    """

    hessian: Array
    gradient: Array
    weight: float
    energy: float
    row_weights: Array


class _Side:
    """One mixture as the kernels want it: neighbours together, float32, one row per component."""

    def __init__(self, mixture: Mixture, isotropic: bool) -> None:
        amplitudes = mixture.weights * mixture.variances() ** (-0.5 * mixture.dimension)
        amplitudes /= amplitudes.max()
        # A pair cannot weigh more than the amplitude of its vaguer half: what is too vague reaches nowhere by itself.
        bits = np.maximum(0.0, CUT_BITS + np.log2(amplitudes))
        reaches_sq = bits / LOG2_SCALE * mixture.largest_variances()
        self.order = morton_order(mixture.points, last=bits == 0.0)
        self.points = _float32(mixture.points[self.order].T)
        precisions = LOG2_SCALE * mixture.packed_precisions()[: 1 if isotropic else 6, self.order]
        self.precisions = _float32(precisions)
        self.amplitudes = _float32(amplitudes[self.order])
        self.reaches_sq = _float32(reaches_sq[self.order])


class PairLoop:
    """The pairs of a source and a target mixture (normalised coordinates), evaluated by the CPU kernels."""

    def __init__(self, source: Mixture, target: Mixture) -> None:
        self._isotropic = source.isotropic and target.isotropic
        self._source, self._target = _Side(source, self._isotropic), _Side(target, self._isotropic)
        self._tiles: Tiles = make_tiles(self._target.points, self._target.reaches_sq)
        self._chunks = -(-len(source) // CHUNK)
        self._partials = np.empty((self._chunks, TOTAL_SUMS))
        self._row_weights, self._nearest = np.empty(len(source)), np.empty(len(source))
        self._no_reach = np.zeros(len(source), np.float32)
        self._scaled = np.empty_like(self._target.precisions)
        self._threads = max(1, min(numba.get_num_threads(), len(source) * len(target) // PAIRS_PER_THREAD))

    def sums(self, pose: Array, source_sigma: float, target_sigma: float) -> PairSums:
        """The E-step at `pose` (4, 4), the covariances of either side times its σ, summed up for the M-step."""
        source, target = self._source, self._target
        np.multiply(target.precisions, np.float32(1.0 / target_sigma), out=self._scaled)
        self._run(
            cpu.pair_sums,
            _packed_pose(pose),
            np.array([source_sigma, target_sigma], np.float32),
            (source.points, source.precisions, source.amplitudes, source.reaches_sq),
            (target.points, self._scaled, target.amplitudes),
            self._tiles,
            self._isotropic,
            0,
            self._chunks,
            self._partials,
            self._row_weights,
        )
        total = np.add.reduce(self._partials, axis=0)
        total[:TOTAL_WEIGHT] /= LOG2_SCALE
        total[TOTAL_ENERGY] /= LOG2_SCALE
        hessian = np.empty((6, 6))
        hessian[UPPER] = total[HESSIAN:GRADIENT]
        hessian.T[UPPER] = total[HESSIAN:GRADIENT]
        row_weights = np.empty_like(self._row_weights)
        row_weights[source.order] = self._row_weights
        return PairSums(
            hessian, total[GRADIENT:TOTAL_WEIGHT].copy(), total[TOTAL_WEIGHT], total[TOTAL_ENERGY], row_weights
        )

    def nearest_sq(self, pose: Array) -> Array:
        """(M,) squared distance of each source point at `pose` to its nearest target point."""
        self._run(
            cpu.nearest_sq,
            _packed_pose(pose),
            self._source.points,
            self._no_reach,
            self._target.points,
            self._tiles,
            0,
            self._chunks,
            self._nearest,
        )
        nearest = np.empty_like(self._nearest)
        nearest[self._source.order] = self._nearest
        return nearest

    def _run(self, kernel, *args) -> None:
        threads = numba.get_num_threads()
        numba.set_num_threads(min(threads, self._threads))
        try:
            kernel(*args)
        finally:
            numba.set_num_threads(threads)


def _packed_pose(pose: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(pose[:3], np.float32).ravel()


def _float32(array: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, np.float32)
