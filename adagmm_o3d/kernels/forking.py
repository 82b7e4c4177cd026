"""Registration in a process forked from one that has registered before."""

from __future__ import annotations

import ctypes
import os
import sys


def keep_working_after_fork() -> None:
    """Let the kernels run on in forked children, on one thread; the bits do not depend on it.

    A child has none of its parent's OpenMP threads: GNU OpenMP would wait for them for ever, and Numba therefore ends
    the process. On one thread nothing is waited for. Processes that are spawned keep all their threads.
    """
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=_one_thread)


def _one_thread() -> None:
    numba = sys.modules.get("numba")
    if numba is None:  # no registration yet
        return
    try:
        layer = numba.threading_layer()
    except ValueError:  # no kernel has run yet: the child starts threads of its own
        return
    if layer != "omp":  # Numba's other layers survive a fork
        return
    from numba.np.ufunc import omppool

    # makes the child the process that its OpenMP belongs to, as Numba does for the first kernel of any process
    ctypes.CFUNCTYPE(None, ctypes.c_int)(omppool.launch_threads)(1)
    numba.set_num_threads(1)
