"""Serial kernels run side by side, each thread on a range of the work.

Numba compiles a parallel kernel several times over, which is too long for the largest ones. These let go of the
interpreter lock, and threads of Python's run them.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numba

from adagmm_o3d.kernels.cpu.compiling import is_compiled

# More ranges than threads: some take longer than others.
RANGES_PER_THREAD = 2


def run_in_ranges(kernel: Callable[..., None], run: Callable[[int, int], None], count: int, threads: int) -> None:
    """Call `run(first, last)`, which calls `kernel`, for ranges that cover 0..count.

    On up to so many threads, this one among them, and no more than Numba may use. What `run` does for one item must not
    depend on the others.
    """
    threads = min(threads, count, numba.get_num_threads())
    # What has still to be compiled is compiled on this thread, where Ctrl-C gets through.
    if threads <= 1 or not is_compiled(kernel):
        run(0, count)
        return
    parts = min(count, RANGES_PER_THREAD * threads)
    ranges = deque((part * count // parts, (part + 1) * count // parts) for part in range(parts))

    def work() -> None:
        while True:
            try:
                one = ranges.popleft()
            except IndexError:
                return
            run(*one)

    helpers = [_pool(os.getpid()).submit(work) for _ in range(threads - 1)]
    try:
        work()
    finally:
        ranges.clear()
        waited_for = [helper for helper in helpers if not helper.cancel()]
    for helper in waited_for:
        helper.result()


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """The helpers of a process; a forked child has none of its parent's threads."""
    return ThreadPoolExecutor(numba.config.NUMBA_NUM_THREADS, thread_name_prefix=f"adagmm_o3d-{process}")
