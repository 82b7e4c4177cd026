"""A cloud that lies on the device as a mixture: checked and normalised there, the host sees only what it has to.

What leaves the device for every point is a byte of findings, one variance and a place on a curve: no point and no
covariance does, but those that the coarse levels choose.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adagmm_o3d.arguments import Array, float_array
from adagmm_o3d.errors import InputError
from adagmm_o3d.kernels.cuda.clouds import inspecting, packing, summing
from adagmm_o3d.kernels.cuda.clouds import surface as surface_kernels
from adagmm_o3d.kernels.cuda.clouds.inspecting import COVARIANCE, LARGEST, POINT_ROWS, VARIANCE
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda
from adagmm_o3d.kernels.cuda.held import upload
from adagmm_o3d.mixtures.checks import (
    FEW_POINTS,
    check_count,
    check_extent,
    check_largest,
    check_not_empty,
    check_rank,
    check_spread,
    check_usable,
    refuse_asymmetric,
    refuse_indefinite,
    spread_of,
    typical_variance,
)
from adagmm_o3d.mixtures.mixture import Mixture, make_mixture
from adagmm_o3d.mixtures.normalisation import VARIANCE_RANGE
from adagmm_o3d.uncertainty.surface import check_count as check_surface_count

SQUARE = np.array([0, 1, 2, 1, 3, 4, 2, 4, 5])  # a packed matrix unfolded


class Frame(NamedTuple):
    """How a table's points and covariances are to be read, see `normalisation.Normalisation`.

    least, most : the bounds of relative variances.
    """

    centre: tuple[float, float, float]
    scale: float
    unit: float
    least: float
    most: float


AS_GIVEN = Frame((0.0, 0.0, 0.0), 1.0, 1.0, 0.0, math.inf)


class DeviceMixture(Mixture):
    """A `Mixture` of three dimensions on the device, all weights 1.

    table : (POINT_ROWS, n) float64 on the device, see `inspecting`.   raw : (n,) its variances on the host.
    relative : (n,) the variances in the frame.
    """

    table: Any
    frame: Frame
    _raw: Array
    _relative: Array

    def __init__(
        self,
        table: Any,
        isotropic: bool,
        kept: NDArray[np.bool_],
        regularised: int,
        raw: Array,
        relative: Array,
        frame: Frame,
    ) -> None:
        self.__dict__.update(
            weights=np.ones(len(raw)), dimension=3, isotropic=isotropic, kept=kept, table=table, frame=frame
        )
        self.__dict__.update(regularised=regularised, _raw=raw, _relative=relative)

    @property
    def on_device(self) -> bool:
        return True

    def __len__(self) -> int:
        return len(self.weights)

    @cached_property
    def points(self) -> Array:  # type: ignore[override]
        """(n, 3) on the host; copied when they are first asked for."""
        return self._everything.points

    @cached_property
    def covariances(self) -> Array:  # type: ignore[override]
        """(n, 3, 3) on the host; copied when they are first asked for."""
        return self._everything.covariances

    @cached_property
    def _everything(self) -> Mixture:
        return self.take(np.arange(len(self)))

    def take(self, index: NDArray[np.integer] | NDArray[np.bool_]) -> Mixture:
        """The mixture of the chosen components, on the host."""
        index = np.arange(len(self))[index]
        chosen = self._chosen(index, VARIANCE)
        factors = self._relative[index] / (self._raw[index] / self.frame.unit) / self.frame.unit
        covariances = (chosen[COVARIANCE:VARIANCE] * factors)[SQUARE].T.reshape(-1, 3, 3)
        return Mixture(
            self._in_frame(chosen),
            np.ascontiguousarray(covariances),
            self.weights[index],
            self.dimension,
            self.isotropic,
            self.kept,
            self.regularised,
            None if self.colours is None else self.colours[index],
        )

    def points_at(self, index: NDArray[np.integer]) -> Array:
        return self._in_frame(self._chosen(index, COVARIANCE))

    @property
    def variances(self) -> Array:  # type: ignore[override]
        return self._relative

    def centroid(self, weights: Array) -> Array:
        origin = self.bounds[0]
        total = moments(self.table, upload(weights), origin)
        return origin + total[summing.FIRST : summing.SECOND] / total[0]

    def radius(self, centre: Array, weights: Array) -> float:
        total = moments(self.table, upload(weights), centre)
        return math.sqrt(np.trace(_unfolded(total[summing.SECOND :])) / total[0])

    def normalised(self, centre: Array, scale: float, unit: float, relative: Array) -> DeviceMixture:
        x, y, z = (float(c) for c in centre)
        frame = Frame((x, y, z), float(scale), float(unit), *VARIANCE_RANGE)
        normalised = DeviceMixture(self.table, self.isotropic, self.kept, self.regularised, self._raw, relative, frame)
        normalised.__dict__["colours"] = self.colours
        normalised.__dict__["bounds"] = (self.bounds - centre) / scale
        return normalised

    @cached_property
    def bounds(self) -> Array:
        """(2, 3) the least and the greatest coordinates."""
        return bounds_of(self.table)

    def _chosen(self, index: NDArray[np.integer], rows: int) -> Array:
        """(rows, k) the first rows of the table at `index`, on the host."""
        if len(index) == 0:  # nothing to launch
            return np.empty((rows, 0))
        return _gathered(self.table, index, rows).copy_to_host()

    def _in_frame(self, chosen: Array) -> Array:
        """(k, 3) points of the table's first rows."""
        return np.ascontiguousarray(((chosen[:3].T) - self.frame.centre) / self.frame.scale)


def uploaded_mixture(name: str, points: ArrayLike, covariances: ArrayLike | None) -> Mixture:
    """As `make_mixture`, checked and kept on the device; clouds in the plane, which are small, stay on the host."""
    p = float_array(f"{name}.points", points, ("n", (2, 3)), finite=False)
    if p.shape[1] == 2:
        return make_mixture(name, p, covariances)
    c = None
    if covariances is not None:
        c = upload(float_array(f"{name}.covariances", covariances, (len(p), 3, 3), finite=False))
    return device_mixture(name, upload(p), c, surface=False)


def device_mixture(name: str, positions: Any, covariances: Any | None, *, surface: bool = True) -> DeviceMixture:
    """As `make_mixture`, for arrays on the device: (n, 3) and (n, 3, 3), float32 or float64.

    Where there are no covariances, those of the `surface` stand in, as `estimate_surface_covariances` finds them, or
    else the identity.
    """
    n = positions.shape[0]
    _check_shape(f"{name}.points", positions, (n, 3))
    if covariances is not None:
        _check_shape(f"{name}.covariances", covariances, (n, 3, 3))
    check_not_empty(name, n)
    table = cuda.device_array((POINT_ROWS, n), np.float64)
    status = cuda.device_array(n, np.uint8)
    inspect = inspecting.inspect_bare if covariances is None else inspecting.inspect_given
    inspect[_blocks(n), TILE](positions, positions if covariances is None else covariances, table, status)
    findings = status.copy_to_host()
    fault, flags = findings & inspecting.FAULTS, findings & ~np.uint8(inspecting.FAULTS)
    measured = fault != inspecting.POINT_NOT_FINITE
    usable = measured & (fault != inspecting.COVARIANCE_NOT_FINITE)
    check_usable(name, measured, usable)
    if (fault == inspecting.CROOKED).any():
        refuse_asymmetric(name, np.flatnonzero(fault == inspecting.CROOKED))
    if (fault == inspecting.NOT_POSITIVE).any():
        refuse_indefinite(name, np.flatnonzero(fault == inspecting.NOT_POSITIVE))
    if not usable.all():
        table, flags = _gathered(table, np.flatnonzero(usable), POINT_ROWS), flags[usable]
    empty = (flags & inspecting.EMPTY).any()
    if empty:
        variance = typical_variance(name, table[LARGEST].copy_to_host())
        inspecting.fill_empty[_blocks(table.shape[1]), TILE](table, variance)
    check_count(name, usable)
    bounds = bounds_of(table)
    check_largest(name, float(np.abs(bounds).max()))
    isotropic = not (flags & inspecting.ANISOTROPIC).any()
    regularised = int(((flags & (inspecting.SINGULAR | inspecting.EMPTY)) != 0).sum())
    if covariances is None and surface:
        _estimate_surface(name, table, bounds)
        isotropic = False
    variances = table[VARIANCE].copy_to_host()
    mixture = DeviceMixture(table, isotropic, usable, regularised, variances, variances, AS_GIVEN)
    mixture.__dict__["bounds"] = bounds
    _check_spread(name, mixture)
    return mixture


def curve_order(table: Any, frame: Frame, bounds: Array, last: NDArray[np.bool_] | None = None) -> NDArray[np.int32]:
    """(n,) a table's points in the order of `kernels.cpu.tiles.morton_order`; `bounds` are in the frame."""
    extent = float((bounds[1] - bounds[0]).max()) or 1.0
    codes = cuda.device_array(table.shape[1], np.uint32)
    low = tuple(float(x) for x in bounds[0])
    packing.morton_codes[_blocks(table.shape[1]), TILE](
        table, frame.centre, frame.scale, low, packing.LAST_CELL / extent, codes
    )
    # Sorting code and place as one number is a stable sort, and by far the fastest that NumPy has.
    keys = codes.copy_to_host().astype(np.uint64) << np.uint64(32)
    if last is not None:
        keys |= last.astype(np.uint64) << np.uint64(62)
    keys |= np.arange(len(keys), dtype=np.uint64)
    keys.sort()
    return keys.astype(np.uint32).astype(np.int32)


def bounds_of(table: Any) -> Array:
    """(2, 3) the least and the greatest coordinates of a table."""
    blocks = min(_blocks(table.shape[1]), summing.MOST_BLOCKS)
    partials = cuda.device_array((6, blocks), np.float64)
    summing.bounds[blocks, TILE](table, partials)
    found = partials.copy_to_host()
    return np.array([found[:3].min(axis=1), found[3:].max(axis=1)])


def moments(table: Any, weights: Any, origin: Array, shift: Array | None = None, scale: float = 1.0) -> Array:
    """(MOMENTS,) see `summing.moments`."""
    blocks = min(_blocks(table.shape[1]), summing.MOST_BLOCKS)
    partials = cuda.device_array((summing.MOMENTS, blocks), np.float64)
    at, by = (tuple(float(x) for x in v) for v in (origin, np.zeros(3) if shift is None else shift))
    summing.moments[blocks, TILE](table, weights, at, by, float(scale), partials)
    return np.add.reduce(partials.copy_to_host(), axis=1)


def _check_shape(name: str, array: Any, wanted: tuple[int, ...]) -> None:
    if tuple(array.shape) != wanted:
        raise InputError(f"{name}: expected shape {wanted}, got {tuple(array.shape)}")


def _check_spread(name: str, mixture: DeviceMixture) -> None:
    """As `checks.check_spread`."""
    n = len(mixture)
    if n < FEW_POINTS:
        check_spread(name, mixture.points_at(np.arange(n)))
        return
    ones, (low, high) = upload(np.ones(n)), mixture.bounds
    mean = moments(mixture.table, ones, low)[summing.FIRST : summing.SECOND] / n
    extent = float(np.maximum((high - low) - mean, mean).max())
    check_extent(name, extent)
    if extent > 0.0:
        products = moments(mixture.table, ones, low, mean, extent)[summing.SECOND :]
        spread = spread_of(_unfolded(products))
    else:
        spread = np.zeros(3)
    check_rank(name, spread, n, float(np.abs(mixture.bounds).max()) / (extent or 1.0))


def _estimate_surface(name: str, table: Any, bounds: Array) -> None:
    """Fill in the covariances of the surface."""
    n = table.shape[1]
    check_surface_count(f"{name}.points", n, 3)
    order = curve_order(table, AS_GIVEN, bounds)
    ordered = _gathered(table, order, POINT_ROWS)
    tiles = _blocks(n)
    boxes = cuda.device_array((tiles, 6), np.float64)
    surface_kernels.point_boxes[tiles, TILE](ordered, boxes)
    surface_kernels.surface_covariances[tiles, TILE](ordered, boxes, upload(order), table)


def _gathered(table: Any, index: NDArray[np.integer], rows: int) -> Any:
    """(rows, k) the first rows of a table at `index`."""
    chosen = cuda.device_array((rows, len(index)), np.float64)
    packing.gather[_blocks(len(index)), TILE](table, upload(index.astype(np.int32)), chosen)
    return chosen


def _unfolded(packed: Array) -> Array:
    return packed[SQUARE].reshape(3, 3)


def _blocks(n: int) -> int:
    return -(-n // TILE)
