"""These tests run in a process of their own, with the simulator on: `test_cuda_simulator.py` starts it."""

import sys
import threading

import numpy as np

from adagmm_o3d.kernels.cuda.availability import simulated

if simulated():
    from numba.cuda.simulator.kernelapi import FakeCUDAShared

    # The simulator polls its threads while they wait for Python's lock; by default they get it 200 times a second.
    sys.setswitchinterval(2e-5)
    allocating = threading.Lock()

    def shared_array(self, shape, dtype):
        """The array of this line of the kernel, the same for all threads, and full of what nobody has written.

        The simulator's own may give two threads that come at the same moment an array each.
        """
        caller = sys._getframe(1)
        line = (caller.f_code.co_filename, caller.f_lineno)
        with allocating:
            if line not in self._allocations:
                dtype = np.dtype(str(dtype))
                self._allocations[line] = np.full(shape, np.nan if dtype.kind == "f" else -1, dtype)
        return self._allocations[line]

    FakeCUDAShared.array = shared_array
else:
    collect_ignore_glob = ["test_*.py"]
