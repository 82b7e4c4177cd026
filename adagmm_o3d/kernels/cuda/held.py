"""Vectors that stay on the device until somebody reads them."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from ...arguments import Array
from .front_end import cuda


class Held:
    """(n,) float64 on the device in the kernels' order; on the host it is in the mixture's order.

    The buffers under it are used in turn. One that is needed again while its vector is still alive is read first, so a
    vector never changes.
    """

    def __init__(self, buffers: tuple[Any, ...], restore: Callable[[Array], Array], size: int) -> None:
        self.buffers: tuple[Any, ...] | None = buffers
        self._restore, self._size = restore, size
        self._values: Array | None = None

    def read(self) -> Array:
        """(n,) on the host; copied once."""
        if self._values is None:
            assert self.buffers is not None
            self._values = self._restore(self.buffers[0].copy_to_host()[: self._size])
        return self._values

    def release(self) -> None:
        """Read what is not read yet and let go of the buffers."""
        self.read()
        self.buffers = None

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        values = self.read()
        return values.copy() if dtype is None else values.astype(dtype)


class Late(NDArrayOperatorsMixin):
    """A vector with its totals that is worked out when one of them is first asked for."""

    def __init__(self, work_out: Callable[[], tuple[Held, Array]]) -> None:
        self._work_out = work_out

    @cached_property
    def _found(self) -> tuple[Held, Array]:
        return self._work_out()

    @property
    def held(self) -> Held:
        """The vector on the device."""
        return self._found[0]

    @property
    def totals(self) -> Array:
        """What it adds up to."""
        return self._found[1]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return self.held.__array__(dtype, copy)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **settings: Any) -> Any:
        """Arithmetic is done on the host."""
        return getattr(ufunc, method)(*(v.held.read() if isinstance(v, Late) else v for v in inputs), **settings)


class Turn:
    """Two sets of buffers used in turn: one pass reads what the pass before has left."""

    def __init__(self, shapes_and_dtypes: list[tuple[Any, Any]], restore: Callable[[Array], Array], size: int) -> None:
        self._sets = [tuple(cuda.device_array(s, d) for s, d in shapes_and_dtypes) for _ in range(2)]
        self._restore, self._size = restore, size
        self._holders: list[weakref.ref[Held] | None] = [None, None]
        self._next = 0

    def take(self) -> Held:
        """The vector that the next pass is to fill."""
        i = self._next
        holder = self._holders[i]
        if holder is not None and (held := holder()) is not None:
            held.release()
        held = Held(self._sets[i], self._restore, self._size)
        self._holders[i] = weakref.ref(held)
        self._next = 1 - i
        return held

    def holds(self, held: Held) -> bool:
        """Whether a vector is in one of these buffers still."""
        return any(held.buffers is buffers for buffers in self._sets)

    def arrays(self) -> list[Any]:
        """Every buffer."""
        return [array for buffers in self._sets for array in buffers]


def upload(values: np.ndarray) -> Any:
    """A copy on the device."""
    return cuda.to_device(np.ascontiguousarray(values))
