"""Serial kernels run side by side, each thread on a stretch of the work."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba

# More stretches than threads: some take longer than others.
STRETCHES_PER_THREAD = 2


def run_in_stretches(run: Callable[[slice], None], count: int, threads: int) -> None:
    """Call `run` for stretches that cover 0..count, on up to so many threads and no more than Numba may use.

    `run` must let go of the interpreter lock, and what it does for one item must not depend on the others.
    """
    threads = min(threads, count, numba.get_num_threads())
    if threads <= 1:
        run(slice(0, count))
        return
    parts = min(count, STRETCHES_PER_THREAD * threads)
    bounds = [part * count // parts for part in range(parts + 1)]
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(run, map(slice, bounds[:-1], bounds[1:])):
            pass
