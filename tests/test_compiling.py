"""Kernels are compiled once for a machine, said to be, and run side by side on stretches of the work."""

import os
import subprocess
import sys

import numba
import pytest

from adagmm_o3d.kernels.compiling import is_compiled
from adagmm_o3d.stretches import run_in_stretches

CHOOSE = """
import numpy as np
from adagmm_o3d.kernels.compiling import is_compiled
from adagmm_o3d.kernels.farthest_points import farthest_points

assert not is_compiled(farthest_points)
for _ in range(2):
    farthest_points(np.eye(3), 2, np.empty(3, np.int64))
    assert is_compiled(farthest_points)
"""


def test_compiling_is_announced_once_and_only_where_there_is_some(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run([sys.executable, "-c", CHOOSE], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    first, second = (outcome.stderr.splitlines() for outcome in said)
    assert first == ["compiling kernels for this machine, once; this takes about half a minute"]
    assert second == []


def test_what_is_not_compiled_by_numba_needs_no_compiling():
    assert is_compiled(len)


@pytest.mark.parametrize("threads", [0, 1, 2, 7])
@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_stretches_cover_everything_once(count, threads):
    items = list(range(count))
    run = []
    run_in_stretches(lambda part: run.append(items[part]), count, threads)
    assert all(run)
    assert sorted(item for part in run for item in part) == items
    allowed = min(threads, count, numba.get_num_threads())
    assert len(run) == (1 if allowed <= 1 else min(count, 2 * allowed))


def test_what_goes_wrong_on_a_stretch_is_heard():
    def run(part):
        if part.start > 0:
            raise ValueError("on a stretch")

    if numba.get_num_threads() == 1:
        pytest.skip("Numba has one thread here")
    with pytest.raises(ValueError, match="on a stretch"):
        run_in_stretches(run, 8, 2)
