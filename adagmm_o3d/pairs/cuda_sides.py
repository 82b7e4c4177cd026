"""One mixture in tiles on the device: uploaded, or packed where it lies; the pair loop sees no difference."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cuda.clouds import packing
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda
from adagmm_o3d.kernels.cuda.held import upload
from adagmm_o3d.kernels.cuda.tiles import boxes, point_tiles, tiled
from adagmm_o3d.mixtures.device_mixture import DeviceMixture, curve_order
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.pairs.cpu_pairs import Side, amplitudes_and_bits


class TiledSide(Protocol):
    """order : (n,) the mixture's points in the order of the tiles.   boxes : (tiles, 8), see `tiles`."""

    order: NDArray[Any]
    boxes: Any

    def precision_tiles(self) -> Any:
        """(tiles, 4 + 1 or 6, TILE) float32 with the amplitudes as shares and the precisions, in powers of two."""

    def covariance_tiles(self) -> Any:
        """The same with the weights, which sum to 1, and the covariances."""

    def amplitude_tiles(self) -> Any:
        """(tiles, TILE) float64 amplitudes, 0 beyond the last point."""

    def weight_tiles(self) -> Any:
        """The same with the weights."""

    def restore(self, values: Array) -> Array:
        """Values in the order of the tiles, put back into the mixture's."""


def make_side(mixture: Mixture, isotropic: bool) -> TiledSide:
    """One side of the pairs, wherever the mixture lies."""
    return ResidentSide(mixture, isotropic) if isinstance(mixture, DeviceMixture) else UploadedSide(mixture, isotropic)


class UploadedSide:
    """A mixture that lies on the host."""

    def __init__(self, mixture: Mixture, isotropic: bool) -> None:
        self._mixture, self._side = mixture, Side(mixture, isotropic)
        self.order = self._side.order
        self.boxes = upload(boxes(self._side.points, self._side.variances, self._side.bits))

    def precision_tiles(self) -> Any:
        return upload(point_tiles(self._side.points, self._side.amplitudes, self._side.precisions(self._mixture)))

    def covariance_tiles(self) -> Any:
        return upload(point_tiles(self._side.points, self._side.weights32, self._side.covariances(self._mixture)))

    def amplitude_tiles(self) -> Any:
        return upload(tiled(self._side.amplitudes.astype(np.float64), 0.0))

    def weight_tiles(self) -> Any:
        return upload(tiled(self._side.weights, 0.0))

    def restore(self, values: Array) -> Array:
        return self._side.restore(values)


class ResidentSide:
    """A mixture that lies on the device."""

    def __init__(self, mixture: DeviceMixture, isotropic: bool) -> None:
        self._mixture, self._isotropic = mixture, isotropic
        amplitudes, bits = amplitudes_and_bits(mixture)
        self.order = curve_order(mixture.table, mixture.frame, mixture.bounds, last=bits == 0.0)
        self._amplitudes = (amplitudes * mixture.weights)[self.order].astype(np.float32)
        self._weights = mixture.weights[self.order] / mixture.weights.sum()
        self._order, self._bits = upload(self.order), upload(tiled(bits[self.order].astype(np.float32)))
        self.boxes = cuda.device_array((self._bits.shape[0], 8), np.float32)
        self._covariance_tiles = self._packed(
            packing.pack_covariances_isotropic if isotropic else packing.pack_covariances, self._weights
        )

    def precision_tiles(self) -> Any:
        kernel = packing.pack_precisions_isotropic if self._isotropic else packing.pack_precisions
        return self._packed(kernel, self._amplitudes)

    def covariance_tiles(self) -> Any:
        return self._covariance_tiles

    def amplitude_tiles(self) -> Any:
        return upload(tiled(self._amplitudes.astype(np.float64), 0.0))

    def weight_tiles(self) -> Any:
        return upload(tiled(self._weights, 0.0))

    def restore(self, values: Array) -> Array:
        restored = np.empty_like(values)
        restored[self.order] = values
        return restored

    def _packed(self, kernel: Any, shares: NDArray[Any]) -> Any:
        tiles = cuda.device_array((self._bits.shape[0], 5 if self._isotropic else 10, TILE), np.float32)
        kernel[self._bits.shape[0], TILE](
            self._mixture.table,
            self._order,
            *self._mixture.frame,
            upload(tiled(shares.astype(np.float32), 0.0)),
            self._bits,
            tiles,
            self.boxes,
        )
        return tiles
