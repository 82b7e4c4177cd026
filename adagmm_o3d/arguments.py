"""Argument checks: each raises one line that names the argument, what was wanted, what came and what to do."""

import math
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.errors import InputError, InputTypeError

Array = NDArray[np.float64]
Extent = int | str | tuple[int, ...]


def float_array(name: str, value: Any, shape: tuple[Extent, ...], *, finite: bool = True) -> Array:
    """`value` as a contiguous float64 array of the wanted shape.

    Parameters
    ----------
    name : what the error calls it.
    value : anything NumPy reads as real numbers: arrays, lists, Open3D vectors.
    shape : one entry per axis: an int (exactly that), a tuple of ints (one of them) or a str (any; the error shows it).
    finite : refuse NaN and infinity.

    Returns
    -------
    float64 array; the caller's own memory where it already is one.

    Raises
    ------
    InputTypeError  if `value` is not an array of real numbers.
    InputError      if an entry is masked, the shape differs or, with `finite`, a number is NaN or infinite (the first
        index is named).
    """
    _refuse_masked(name, value)
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        got = f"a ragged {type(value).__name__}"
        raise InputTypeError(f"{name}: expected an array of real numbers, got {got}") from None
    if array.dtype.kind not in "fiu":
        got = f"dtype {array.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise InputTypeError(f"{name}: expected an array of real numbers, got {got}")
    if array.ndim != len(shape) or not all(map(_fits, array.shape, shape)):
        raise InputError(f"{name}: expected shape {_shown(shape)}, got {_shown(array.shape)}")
    with np.errstate(over="ignore"):  # a long double beyond float64 becomes infinite, and is refused as that
        array = np.ascontiguousarray(array, dtype=np.float64)
    if finite and not np.isfinite(array).all():
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        got = f"{array[index]} at index {_shown(index)}"
        raise InputError(f"{name}: expected finite numbers, got {got}; drop such entries first")
    return array


def bool_array(name: str, value: Any, shape: tuple[Extent, ...]) -> NDArray[np.bool_]:
    """`value` as a boolean array of the wanted shape.

    Raises
    ------
    InputTypeError  if the dtype is not bool (an index list is not a mask).
    InputError      if an entry is masked or the shape differs.
    """
    _refuse_masked(name, value)
    array = np.asarray(value)
    if array.dtype != np.bool_:
        raise InputTypeError(f"{name}: expected booleans, got dtype {array.dtype}; index lists are not masks")
    if array.ndim != len(shape) or not all(map(_fits, array.shape, shape)):
        raise InputError(f"{name}: expected shape {_shown(shape)}, got {_shown(array.shape)}")
    return array


def unit_vectors(name: str, value: Any, shape: tuple[Extent, ...]) -> Array:
    """`value` as rows scaled to unit length.

    Raises
    ------
    InputTypeError, InputError  as `float_array`.
    InputError                  if a row has zero length (the first one is named).
    """
    vectors = float_array(name, value, shape)
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    if not np.all(lengths > 0.0):
        row = int(np.flatnonzero(lengths[..., 0] == 0.0)[0])
        raise InputError(f"{name}: expected non-zero vectors, got length 0 at row {row}; drop that point first")
    return vectors / lengths


def real_number(name: str, value: Any, *, minimum: float = -math.inf, above: float = -math.inf) -> float:
    """`value` as a finite float, at least `minimum` and strictly greater than `above`.

    Raises
    ------
    InputTypeError  if it is not a real number (bool is not one).
    InputError      if it is NaN, infinite or out of range.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (Real, np.floating, np.integer)):
        raise InputTypeError(f"{name}: expected a real number, got {type(value).__name__}")
    number = float(value)
    if not math.isfinite(number) or number < minimum or number <= above:
        limit = f" > {above:g}" if above > -math.inf else f" >= {minimum:g}" if minimum > -math.inf else ""
        raise InputError(f"{name}: expected a finite number{limit}, got {number:g}")
    return number


def distance_limit(name: str, value: Any) -> float:
    """`value` as a float above zero; infinity is no limit.

    Raises
    ------
    InputTypeError  if it is not a real number (bool is not one).
    InputError      if it is NaN, zero or negative.
    """
    if isinstance(value, (float, np.floating)) and value == math.inf:
        return math.inf
    return real_number(name, value, above=0.0)


def whole_number(name: str, value: Any, *, minimum: int) -> int:
    """`value` as an int of at least `minimum`.

    Raises
    ------
    InputTypeError  if it is not an integer (bool and 3.0 are not).
    InputError      if it is too small.
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (Integral, np.integer)):
        raise InputTypeError(f"{name}: expected an integer, got {type(value).__name__}")
    if value < minimum:
        raise InputError(f"{name}: expected an integer >= {minimum}, got {int(value)}")
    return int(value)


def _refuse_masked(name: str, value: Any) -> None:
    """Raise where entries are masked: as a plain array they would count with whatever lies under the mask."""
    parts = value if isinstance(value, (list, tuple)) else (value,)
    count = int(sum(np.count_nonzero(part.mask) for part in parts if isinstance(part, np.ma.MaskedArray)))
    if count:
        entries = "entry is" if count == 1 else "entries are"
        raise InputError(f"{name}: expected an array without a mask, {count} {entries} masked; drop those points first")


def _fits(got: int, wanted: Extent) -> bool:
    if isinstance(wanted, str):
        return True
    return got in wanted if isinstance(wanted, tuple) else got == wanted


def _shown(shape: tuple[Extent, ...]) -> str:
    parts = [" or ".join(map(str, extent)) if isinstance(extent, tuple) else str(extent) for extent in shape]
    return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
