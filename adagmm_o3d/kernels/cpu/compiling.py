"""How the CPU kernels are compiled: the flags that make them vectorise, and a cache that cannot go stale."""

import hashlib
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache

from adagmm_o3d.kernels.cpu.cache_folder import find_a_folder
from adagmm_o3d.kernels.cpu.exp2 import exp2_float32
from adagmm_o3d.kernels.formulas import build

# Each of these is needed for vector code, and none assumes that there are no NaN or infinities.
FAST = {"reassoc", "contract", "arcp", "nsz"}
KERNEL = {"fastmath": FAST, "error_model": "numpy"}
# Of a function that two kernels call each holds a copy of its own, optimised with what surrounds it. Where a kernel
# calls its copy by name, the first one that the process has loaded is taken: fast arithmetic then gives other bits in a
# process that compiles than in one that finds the kernels compiled. So none is called by name.
FLAGS = {**KERNEL, "forceinline": True}
# What is too small to be worth vector code keeps the order of its sums: all who call it get the same bits. That has to
# be said: what says nothing is compiled as the first that calls it.
EXACT_FLAGS = {"error_model": "numpy", "fastmath": False}
# So does a loop that writes what it has worked out for each point. Where the compiler cannot tell whether what is read
# and what is written lie apart it makes two such loops, vector code and plain code, and takes one by where the arrays
# happen to lie: fast arithmetic rounds differently in each.
POINTWISE_FLAGS = {**EXACT_FLAGS, "forceinline": True}
SERIAL_KERNEL_FLAGS = {"cache": find_a_folder(FunctionCache), "nogil": True, **KERNEL}
EXACT_KERNEL_FLAGS = {**SERIAL_KERNEL_FLAGS, **EXACT_FLAGS}
KERNEL_FLAGS = {"parallel": True, **SERIAL_KERNEL_FLAGS}
F0, F1 = np.float32(0.0), np.float32(1.0)

_log = logging.getLogger("adagmm_o3d")


def source_stamp() -> int:
    """A hash of every file that a kernel is made of: those of this folder and of the one above.

    Numba's cache knows only the file a kernel is in. Each kernel has this number as a free variable, which is part of
    the cache key, so that an edit in a file it merely calls into compiles it anew.
    """
    here = Path(__file__).parent
    files = sorted([*here.glob("*.py"), *here.parent.glob("*.py")])
    return int(hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:15], 16)


def is_compiled(kernel: Callable[..., None]) -> bool:
    """Whether a kernel has been compiled, or loaded, in this process; with Numba's compiler switched off all are."""
    return bool(getattr(kernel, "signatures", True))


class _Announcement(event.Listener):
    """Says once that kernels are being compiled, so that nobody takes the first registration for one that hangs."""

    def on_start(self, started: event.Event) -> None:
        if started.data["dispatcher"].py_func.__module__.startswith(__package__):
            _announce()

    def on_end(self, ended: event.Event) -> None:
        """What has ended is of no interest."""


@cache
def _announce() -> None:
    _log.warning("compiling kernels for this machine, once; this takes about half a minute")


event.register("numba:compile", _Announcement())


def _formulas(flags):
    @njit(**flags)
    def inverse_root(x):
        """1/√x of a float32 or a float64, in its own type."""
        return F1 / np.sqrt(x)

    return build(njit(**flags), inverse_root, exp2_float32)


# The formulas for the CPU: for the sums over pairs, and for what is worked out point by point.
formulas, pointwise_formulas = _formulas(FLAGS), _formulas(POINTWISE_FLAGS)
