"""Argument checks: each raises one line that names the argument, what was wanted, what came and what to do."""

import math
import operator
from decimal import Decimal
from numbers import Real
from typing import Any, SupportsFloat, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from adagmm_o3d.errors import InputError, InputTypeError

Array = NDArray[np.float64]
Extent = int | str | tuple[int, ...]

LARGEST_COORDINATE = 1e140
"""Up to here [input units] the squares of coordinates do not overflow."""


def float_array(
    name: str, value: Any, shape: tuple[Extent, ...], *, finite: bool = True, booleans: bool = False
) -> Array:
    """`value` as a contiguous float64 array of the wanted shape.

    Parameters
    ----------
    name : what the error calls it.
    value : anything NumPy reads as real numbers: arrays, lists, Open3D vectors, also of Python's own numbers; and
        tensors, on whatever device.
    shape : one entry per axis: an int (exactly that), a tuple of ints (one of them) or a str (any; the error shows it).
    finite : refuse NaN and infinity.
    booleans : take them for 0 and 1, as in np.eye(4, dtype=bool); among points they are a mask put in the wrong place.

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
        # Open3D's NumPy does not read, nor any that lies on a GPU.
        array = value.cpu().numpy() if type(value).__name__ == "Tensor" else np.asarray(value)
    except (AttributeError, TypeError, ValueError, RuntimeError):
        got = f"a ragged {type(value).__name__}"
        raise InputTypeError(f"{name}: expected an array of real numbers, got {got}") from None
    if array.dtype == object and all(isinstance(entry, (Real, Decimal)) for entry in array.flat):
        array = _as_floats(array)
    if array.dtype.kind not in ("fiub" if booleans else "fiu"):
        got = f"dtype {array.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        raise InputTypeError(f"{name}: expected an array of real numbers, got {got}")
    if array.ndim != len(shape) or not all(map(_fits, array.shape, shape)):
        raise InputError(f"{name}: expected shape {_shown(shape)}, got {_shown(array.shape)}")
    with np.errstate(over="ignore"):  # a long double beyond float64 becomes infinite, and is treated as that
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
    zero = ~vectors.any(axis=-1)
    if zero.any():
        row = int(np.flatnonzero(zero)[0])
        raise InputError(f"{name}: expected non-zero vectors, got length 0 at row {row}; drop that point first")
    vectors = of_moderate_length(vectors)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def check_coordinates(name: str, values: Array) -> None:
    """Raise if the squares of coordinates [input units] overflow."""
    largest = float(np.abs(values).max(initial=0.0))
    if largest > LARGEST_COORDINATE:
        raise InputError(f"{name}: expected coordinates up to {LARGEST_COORDINATE:g}, got {largest:g}; rescale")


def of_moderate_length(vectors: Array) -> Array:
    """Finite vectors (..., D), each times a power of two that brings its largest component near 1.

    Then no square overflows or vanishes, and no digit has changed.
    """
    _, exponents = np.frexp(np.abs(vectors).max(axis=-1, keepdims=True, initial=0.0))
    return np.asarray(np.ldexp(vectors, -exponents), np.float64)


def real_number(name: str, value: Any, *, minimum: float = -math.inf, above: float = -math.inf) -> float:
    """`value` as a finite float, at least `minimum` and strictly greater than `above`.

    Raises
    ------
    InputTypeError  if it is not one real number (bool is not one).
    InputError      if it is NaN, infinite or out of range.
    """
    limit = f" > {above:g}" if above > -math.inf else f" >= {minimum:g}" if minimum > -math.inf else ""
    number = _one_float(name, value, limit)
    if not math.isfinite(number) or number < minimum or number <= above:
        raise InputError(f"{name}: expected a finite number{limit}, got {number:g}")
    return number


def distance_limit(name: str, value: Any) -> float:
    """`value` as a float above zero; infinity is no limit.

    Raises
    ------
    InputTypeError  if it is not one real number (bool is not one).
    InputError      if it is NaN, zero, negative or too large for a float.
    """
    number = _one_float(name, value, " > 0")
    return number if number == math.inf else real_number(name, number, above=0.0)


def whole_number(name: str, value: Any, *, minimum: int) -> int:
    """`value` as an int of at least `minimum`.

    Raises
    ------
    InputTypeError  if it is not an integer (bool and 3.0 are not).
    InputError      if it is too small.
    """
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        number = operator.index(value)
    except TypeError:
        raise InputTypeError(f"{name}: expected an integer, got {_kind(value)}") from None
    if number < minimum:
        raise InputError(f"{name}: expected an integer >= {minimum}, got {number}")
    return number


def true_or_false(name: str, value: Any) -> bool:
    """`value` as a bool.

    Raises
    ------
    InputTypeError  if it is neither Python's nor NumPy's.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise InputTypeError(f"{name}: expected a bool, got {_kind(value)}")
    return bool(value)


def _one_float(name: str, value: Any, limit: str) -> float:
    """`value` as a float: what says itself that it is one real number, such as Decimal or an array without axes."""
    _refuse_masked(name, value)
    # NumPy would make a float of an array with one entry, of True and, with a warning, of a complex number.
    array = value if isinstance(value, (np.ndarray, np.generic)) else None
    one = array is None or (array.ndim == 0 and array.dtype.kind in "fiuO")
    try:
        if not one or isinstance(value, bool) or not isinstance(value, (SupportsFloat, SupportsIndex)):
            raise TypeError
        return float(value)
    except OverflowError:
        raise InputError(f"{name}: expected a finite number{limit}, got one too large for a float") from None
    except (TypeError, ValueError, RuntimeError):
        raise InputTypeError(f"{name}: expected a real number, got {_kind(value)}") from None


def _as_floats(array: NDArray[Any]) -> Array:
    """An array of Python's numbers as floats; one too large for a float becomes infinite, and is treated as that."""

    def number(entry: Any) -> float:
        try:
            return float(entry)
        except OverflowError:
            return math.inf

    return np.array([number(entry) for entry in array.flat], np.float64).reshape(array.shape)


def _kind(value: Any) -> str:
    """What an error calls a value that is not of the kind that was wanted."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {_shown(value.shape)}" if value.ndim else f"an array of dtype {value.dtype}"
    return type(value).__name__


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
