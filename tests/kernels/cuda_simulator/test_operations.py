"""The operations that `adagmm-bench gpu` says a pair takes are those that the kernels do."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from adagmm_bench.gpu.operations import PAIR_OPERATIONS
from adagmm_o3d.kernels.cuda import adaptive_rows, convolved_columns, convolved_rows, front_end
from adagmm_o3d.kernels.cuda.tiles import Packed, Point
from adagmm_o3d.kernels.cuda.tuples import adder


class Counted:
    """A number that counts what is done with it."""

    count = 0

    def __init__(self, value):
        self.value = float(value)

    @staticmethod
    def _operation(function):
        def operate(self, *others):
            if NOTHING in others:
                return self
            Counted.count += 1
            return Counted(function(self.value, *(float(getattr(o, "value", o)) for o in others)))

        return operate

    __add__ = _operation(lambda a, b: a + b)
    __radd__ = _operation(lambda a, b: b + a)
    __sub__ = _operation(lambda a, b: a - b)
    __mul__ = _operation(lambda a, b: a * b)
    __truediv__ = _operation(lambda a, b: a / b)
    __rtruediv__ = _operation(lambda a, b: b / a)
    exp2 = _operation(math.exp2)

    inverse_root = _operation(lambda a: 1.0 / math.sqrt(a))
    __array_ufunc__ = None  # a NumPy number divided by one is left to __rtruediv__

    def sqrt(self):
        """Half of an inverse root, which the device has as one operation; the division counts."""
        return Counted(math.sqrt(self.value))

    def __neg__(self):  # a flag of the operation that follows
        return Counted(-self.value)


# The distance between the colours of points that have none: the compiler adds no zero.
NOTHING = object()
COUNTED_MATH = SimpleNamespace(exp2=Counted.exp2, sqrt=Counted.sqrt)
MATRIX = Packed(*map(Counted, (2.0, 0.1, 0.2, 1.5, 0.3, 1.0)))
Y = Point(*map(Counted, (0.1, 0.2, 0.3)))
ROWS = {
    "adaptive": (adaptive_rows, "pair_full", adaptive_rows.ROWS, [MATRIX]),
    "adaptive isotropic": (adaptive_rows, "pair_isotropic", adaptive_rows.ISOTROPIC_ROWS, [MATRIX.xx]),
    "convolved": (convolved_rows, "pair_full", convolved_rows.ROWS, [MATRIX, False, NOTHING]),
    "convolved isotropic": (
        convolved_rows,
        "pair_isotropic",
        convolved_rows.ISOTROPIC_ROWS,
        [MATRIX.xx, False, NOTHING],
    ),
}
COLUMNS = {
    "columns": ("density_full", [MATRIX, False, NOTHING]),
    "columns isotropic": ("density_isotropic", [MATRIX.xx, False, NOTHING]),
}


@pytest.fixture
def tile():
    entries = [0.5, 0.4, 0.3, 1.0, 2.0, 0.1, 0.2, 1.5, 0.3, 1.0, 0.7]
    return np.array([[Counted(v) for v in entries]])


@pytest.mark.parametrize("name", ROWS)
def test_operations_of_the_row_kernels(name, tile, monkeypatch):
    module, function, sums, matrix = ROWS[name]
    monkeypatch.setattr(module, "math", COUNTED_MATH, raising=False)
    monkeypatch.setattr(module, "inverse_root", Counted.inverse_root, raising=False)
    monkeypatch.setattr(front_end, "math", COUNTED_MATH)
    Counted.count = 0
    terms = getattr(module, function)(tile, 0, Y, *matrix)
    adder(sums, front_end.fast)(tuple(Counted(0.0) for _ in range(sums)), terms)
    assert len(terms) == sums
    assert Counted.count == PAIR_OPERATIONS[name]


@pytest.mark.parametrize("name", COLUMNS)
def test_operations_of_the_column_kernels(name, tile, monkeypatch):
    function, matrix = COLUMNS[name]
    monkeypatch.setattr(front_end, "math", COUNTED_MATH)
    Counted.count = 0
    total = Counted(0.0) + getattr(convolved_columns, function)(tile, 0, Y, *matrix)
    assert total.value > 0.0
    assert Counted.count == PAIR_OPERATIONS[name]
