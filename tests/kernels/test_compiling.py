"""Kernels are compiled once for a machine, said to be, and run side by side on ranges of the work."""

import os
import subprocess
import sys
import threading

import numba
import pytest
from loop_versions import loops_by_address

from adagmm_o3d.kernels.cpu.compiling import is_compiled
from adagmm_o3d.kernels.cpu.ranges import run_in_ranges

CHOOSE = """
import numpy as np
from adagmm_o3d.kernels.cpu.compiling import is_compiled
from adagmm_o3d.kernels.cpu.farthest_points import farthest_points

assert not is_compiled(farthest_points)
for _ in range(2):
    farthest_points(np.eye(3), 2, np.empty(3, np.int64))
    assert is_compiled(farthest_points)
"""

REGISTER = """
import hashlib
import numpy as np
from adagmm_o3d import TransformationEstimationForAdaptiveGMM, register_points

rng = np.random.default_rng(0)
for n, dimension in ((200, 2), (200, 3), (1300, 3)):
    points = rng.normal(size=(n, dimension)) * [1.0, 0.6, 0.3][:dimension]
    points[:, -1] += points[:, 0] ** 2
    noisy = points + 0.02 * rng.normal(size=points.shape)
    scatter = 0.5 * rng.normal(size=(n, dimension, dimension))
    covariances = scatter @ scatter.transpose(0, 2, 1) + np.eye(dimension)
    colors = rng.uniform(size=(n, 3))
    for given in ((), (covariances, covariances)):
        for method in ({}, {"sigma_rule": "nearest"}, {"color": True}):
            result = register_points(
                noisy, points + 0.1, *given,
                estimation_method=TransformationEstimationForAdaptiveGMM(**method),
                source_colors=colors, target_colors=colors,
            )
            print("bits", hashlib.sha256(result.transformations.tobytes() + result.row_weights.tobytes()).hexdigest())
"""

TWO_VERSIONS = """
import numba, numpy as np

def add(a, b, c):
    for i in range(len(a)):
        c[i] = a[i] * b[i] + a[i]

for name, fastmath in (("fast", {"contract"}), ("exact", False)):
    add.__name__ = add.__qualname__ = name
    numba.njit(fastmath=fastmath)(add)(*np.ones((3, 100)))
"""


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    """The same registrations by one process that compiles all of its kernels, and prints them, and one that finds them
    compiled."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("kernels"))}
    return [
        subprocess.run(
            [sys.executable, "-c", REGISTER], env=environment | dump, capture_output=True, text=True, check=True
        )
        for dump in ({"NUMBA_DUMP_OPTIMIZED": "1"}, {})
    ]


@pytest.mark.slow
def test_a_process_that_compiles_gets_the_bits_of_one_that_finds_kernels_compiled(processes):
    first, second = processes
    assert "compiling" in first.stderr and "compiling" not in second.stderr
    bits = [[line for line in process.stdout.splitlines() if line.startswith("bits")] for process in processes]
    assert len(bits[0]) == 18 and bits[0] == bits[1]


@pytest.mark.slow
def test_where_arrays_lie_does_not_decide_how_a_loop_rounds(processes):
    module = processes[0].stdout
    assert "run_em" in module and "adaptive_sums" in module and "vector.memcheck" in module
    assert list(loops_by_address(module)) == []


@pytest.mark.slow
def test_a_loop_that_rounds_by_where_arrays_lie_is_found(tmp_path):
    environment = os.environ | {"NUMBA_DUMP_OPTIMIZED": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    process = subprocess.run(
        [sys.executable, "-c", TWO_VERSIONS], env=environment, capture_output=True, text=True, check=True
    )
    found = [name for name, _ in loops_by_address(process.stdout)]
    assert len(found) == 1 and "fast" in found[0]


@pytest.mark.slow
def test_compiling_is_announced_once_and_only_where_there_is_some(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run([sys.executable, "-c", CHOOSE], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    first, second = ([line for line in outcome.stderr.splitlines() if "compil" in line] for outcome in said)
    assert first == ["compiling kernels for this machine, once; this takes about half a minute"]
    assert second == []


def test_what_is_not_compiled_by_numba_needs_no_compiling():
    assert is_compiled(len)


@pytest.mark.parametrize("threads", [0, 1, 2, 7])
@pytest.mark.parametrize("count", [1, 2, 3, 10])
def test_ranges_cover_everything_once(count, threads):
    items = list(range(count))
    run = []
    run_in_ranges(len, lambda first, last: run.append(items[first:last]), count, threads)
    assert all(run)
    assert sorted(item for part in run for item in part) == items
    allowed = min(threads, count, numba.get_num_threads())
    assert len(run) == (1 if allowed <= 1 else min(count, 2 * allowed))


@pytest.mark.skipif(numba.get_num_threads() == 1, reason="Numba has one thread here")
def test_ranges_are_shared_by_threads_and_what_goes_wrong_on_another_is_heard():
    both = threading.Barrier(2, timeout=60)

    def run(first, last):
        both.wait()
        if threading.current_thread() is not threading.main_thread():
            raise ValueError("elsewhere")

    with pytest.raises(ValueError, match="elsewhere"):
        run_in_ranges(len, run, 2, 2)


def test_an_interrupt_leaves_the_other_ranges_alone():
    run = []

    def interrupted(first, last):
        run.append(first)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_in_ranges(len, interrupted, 100, 2)
    assert len(run) <= 2


def test_what_is_not_compiled_yet_is_compiled_on_this_thread():
    run = []
    run_in_ranges(numba.njit(lambda x: x), lambda *part: run.append((threading.current_thread(), *part)), 8, 2)
    assert run == [(threading.main_thread(), 0, 8)]
