"""Vectors that stay on the device until somebody reads them."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.kernels.cuda.front_end import cuda


class Held:
    """(n,) float64 on the device in the kernels' order; on the host it is in the mixture's order.

    There are two buffers, see `Buffers`. One that is needed again while its vector is still alive is read first, so a
    vector never changes.
    """

    def __init__(self, buffer: Any, restore: Callable[[Array], Array], size: int) -> None:
        self.buffer: Any = buffer
        self._restore, self._size = restore, size
        self._values: Array | None = None

    def read(self) -> Array:
        """(n,) on the host; copied once."""
        if self._values is None:
            self._values = self._restore(self.buffer.copy_to_host()[: self._size])
        return self._values

    def release(self) -> None:
        """Read what is not read yet and let go of the buffer."""
        self.read()
        self.buffer = None


class Buffers:
    """Two that passes fill by turns: the vector of one pass outlives the next."""

    def __init__(self, length: int, restore: Callable[[Array], Array], size: int) -> None:
        self._buffers = [cuda.device_array(length, np.float64) for _ in range(2)]
        self._restore, self._size = restore, size
        self._holders: list[weakref.ref[Held] | None] = [None, None]
        self._next = 0

    def take(self) -> Held:
        """The vector that the next pass is to fill."""
        i = self._next
        holder = self._holders[i]
        if holder is not None and (held := holder()) is not None:
            held.release()
        held = Held(self._buffers[i], self._restore, self._size)
        self._holders[i] = weakref.ref(held)
        self._next = 1 - i
        return held

    def arrays(self) -> list[Any]:
        """Every buffer."""
        return list(self._buffers)


def upload(values: np.ndarray) -> Any:
    """A copy on the device."""
    return cuda.to_device(np.ascontiguousarray(values))
