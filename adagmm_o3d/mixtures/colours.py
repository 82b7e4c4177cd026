"""Colours as further coordinates of a Gaussian: how alike two of them are, and how that is said to the kernels.

Colours are kept in CIE 1976 L*a*b* (D65), where equal distances look equally different: lightness apart from hue, so
that exposure changes one coordinate. Of intensities only the first coordinate is used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adagmm_o3d.arguments import Array, float_array
from adagmm_o3d.errors import InputError
from adagmm_o3d.kernels.formulas import LOG2_SCALE

# Linear sRGB to XYZ, each row divided by that of white.
XYZ_OF_RGB = np.array([[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]])
XYZ_OF_RGB /= XYZ_OF_RGB.sum(axis=1, keepdims=True)
# Below this share of white L*a*b* is linear.
LINEAR = (6.0 / 29.0) ** 3
# Intensities are scaled so that this share of them lies below FULL, the lightness of white.
BRIGHT, FULL = 0.99, 100.0
# Two sensors whose bright intensities are further apart than this write them in different units.
SAME_UNIT = 2.5
# By so much rounding may bring a colour above 1, and interpolation, which overshoots at edges, beyond 0 and 1.
ROUNDED, OVERSHOT = 1e-6, 0.05


@dataclass(frozen=True)
class ColourModel:
    """How the colours of two points are distributed that are the same place, beside those that are not.

    deviations : (3,) standard deviations of their differences.   gain, offset : (3,) what the source's sensor makes of
    a colour: gain · source + offset is as the target has it.   lying : share of the points that are the same place
    and look different none the less (highlights, shadows).   floor : how far the density of a difference falls, in
    terms of that of none: exp(-floor).   expected : mean of exp(-min(½ Σ (Δ / deviations)², floor)) over pairs that
    have nothing to do with each other.
    """

    deviations: Array
    gain: Array
    offset: Array
    lying: float
    floor: float
    expected: float

    @property
    def cap(self) -> np.float32:
        """The floor in powers of two, as `kernels.cpu.convolved_rows` wants it."""
        return np.float32(self.floor / math.log(2.0))

    def hues(self, colours: Array, *, of_source: bool) -> NDArray[np.float32]:
        """(3, n) of (n, 3) colours, in units in which the weight of a pair halves where they differ by one."""
        in_powers_of_two = math.sqrt(2.0 * LOG2_SCALE)
        return np.ascontiguousarray((in_powers_of_two * self.scaled(colours, of_source=of_source)).T, np.float32)

    def scaled(self, colours: Array, *, of_source: bool) -> Array:
        """(n, 3) of (n, 3) colours, of which the squared difference of two is the exponent of their density."""
        seen = self.gain * colours + self.offset if of_source else colours
        return np.ascontiguousarray(seen * (math.sqrt(0.5) / self.deviations))


def checked_colors(
    source: ArrayLike | None,
    target: ArrayLike | None,
    kept: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    *,
    needed: bool = False,
) -> tuple[Array, Array] | None:
    """Colours of both clouds, (m, 3) and (n, 3) L*a*b*; None where there are none and none are `needed`.

    Parameters
    ----------
    source, target : (m, 3) and (n, 3) sRGB, 0 to 1 or, as uint8, 0 to 255, or beyond 0 and 1 by OVERSHOT, which is cut
        off; or (m,), (m, 1) and (n,), (n, 1) intensities, of any unit, at least 0.   kept : (m,) and (n,) bool,
        False for the points whose colour does not matter and becomes black.

    Raises
    ------
    InputTypeError, InputError : of one cloud only, colours beside intensities, another shape or range.
    """
    if source is None and target is None and not needed:
        return None
    for name, value, other in (("source", source, target), ("target", target, source)):
        if value is None:
            beside = "as the other cloud has them" if other is not None else "as color is on"
            raise InputError(f"{name}.colors: expected one for each of the points {beside}, got none")
    moving, fixed = _checked("source", source, kept[0]), _checked("target", target, kept[1])
    if moving.ndim != fixed.ndim:
        kinds = ["intensities" if values.ndim == 1 else "colours" for values in (moving, fixed)]
        raise InputError(f"target.colors: expected {kinds[0]} as the source has, got {kinds[1]}")
    if moving.ndim == 1:
        return _lightness(moving, fixed)
    return lab_of(moving), lab_of(fixed)


def _checked(name: str, value: ArrayLike | None, kept: NDArray[np.bool_]) -> Array:
    """(n, 3) from 0 to 1, or (n,) intensities."""
    name = f"{name}.colors"
    as_bytes = np.asarray(value).dtype == np.uint8
    rows = np.asarray(value).ndim
    shape = (len(kept),) if rows == 1 else (len(kept), (3, 1))
    colors = float_array(name, value, shape, finite=False)
    if not kept.all():
        colors = np.where(kept if rows == 1 else kept[:, None], colors, 0.0)
    colors = float_array(name, colors, shape)
    lowest = float(colors.min(initial=0.0))
    intensities = rows == 1 or colors.shape[1] == 1
    if lowest < (0.0 if intensities else -OVERSHOT):
        raise InputError(f"{name}: expected numbers of at least 0, got {lowest:g}")
    if intensities:
        return colors.ravel()
    if as_bytes:
        return colors / 255.0
    highest = float(colors.max(initial=0.0))
    if highest > 1.0 + OVERSHOT:
        raise InputError(f"{name}: expected 0 to 1, got {highest:g}; divide by 255, or by what white is")
    return np.clip(colors, 0.0, 1.0) if lowest < 0.0 or highest > 1.0 + ROUNDED else colors


def lab_of(rgb: Array) -> Array:
    """(n, 3) L*a*b* of (n, 3) sRGB, 0 to 1."""
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = linear @ XYZ_OF_RGB.T
    f = np.where(xyz > LINEAR, np.cbrt(xyz), xyz / (3.0 * LINEAR ** (2.0 / 3.0)) + 4.0 / 29.0)
    return np.stack([116.0 * f[:, 1] - 16.0, 500.0 * (f[:, 0] - f[:, 1]), 200.0 * (f[:, 1] - f[:, 2])], axis=1)


def _lightness(source: Array, target: Array) -> tuple[Array, Array]:
    """(m, 3) and (n, 3) of intensities (m,) and (n,), brought to the range of lightness by the same factor, or each by
    its own where they are in different units."""
    bright = [float(np.quantile(values, BRIGHT)) if len(values) else 0.0 for values in (source, target)]
    if min(bright) > 0.0 and max(bright) > SAME_UNIT * min(bright):
        return _in_first(source * (FULL / bright[0])), _in_first(target * (FULL / bright[1]))
    both = float(np.quantile(np.concatenate([source, target]), BRIGHT))
    scale = FULL / both if both > 0.0 else 1.0
    return _in_first(source * scale), _in_first(target * scale)


def _in_first(values: Array) -> Array:
    colours = np.zeros((len(values), 3))
    colours[:, 0] = values
    return colours
