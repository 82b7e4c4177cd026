"""These tests run in a process of their own, with the simulator on: `test_cuda_simulator.py` starts it."""

import os
import random
import sys
import threading

import numpy as np

from adagmm_o3d.kernels.cuda.availability import simulated

if simulated():
    from numba.cuda.simulator.kernel import BlockManager, BlockThread
    from numba.cuda.simulator.kernelapi import FakeCUDAShared

    order = random.Random(0)
    # Thousands of threads, of which one runs at a time: stacks that are used again, and nothing handed between cores.
    threading.stack_size(1 << 18)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

    def shared_array(self, shape, dtype):
        """The array of this line of the kernel, the same for all threads, and full of what nobody has written."""
        caller = sys._getframe(1)
        line = (caller.f_code.co_filename, caller.f_lineno)
        if line not in self._allocations:
            dtype = np.dtype(str(dtype))
            self._allocations[line] = np.full(shape, np.nan if dtype.kind == "f" else -1, dtype)
        return self._allocations[line]

    def run_block(self, grid_point, *args):
        """One thread of the block after the other, up to where they wait for each other; then on, in another order.

        The simulator's own lets all of them run at once and polls them, most of the time for Python's lock.
        """
        self.turn_over = threading.Semaphore(0)
        points = np.ndindex(*self._block_dim)
        alive = [BlockThread(lambda: self._f(*args), self, grid_point, point, self._debug) for point in points]
        for thread in alive:
            thread.turn = threading.Semaphore(0)
            thread.start()
        while alive:
            order.shuffle(alive)
            for thread in alive:
                thread.turn.release()
                self.turn_over.acquire()
            failed = [thread.exception for thread in alive if thread.exception]
            alive = [thread for thread in alive if not thread.ended]
            if failed:
                for thread in alive:
                    thread.abort = True
                    thread.turn.release()
                raise failed[0][0].with_traceback(failed[0][1])

    def run_thread(self):
        self.ended = False
        self.turn.acquire()
        try:
            run_in_one_go(self)
        finally:
            self.ended = True
            self._manager.turn_over.release()

    def wait_for_all(self):
        self._manager.turn_over.release()
        self.turn.acquire()
        if self.abort:
            raise RuntimeError("another thread of the block has failed")

    run_in_one_go = BlockThread.run
    FakeCUDAShared.array = shared_array
    BlockManager.run, BlockThread.run, BlockThread.syncthreads = run_block, run_thread, wait_for_all
else:
    collect_ignore_glob = ["test_*.py"]
