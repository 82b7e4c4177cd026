"""Several threads, forked and spawned processes, Ctrl-C, and what an import brings in."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from mixtures import random_pose
from shapes import bumpy, move

from adagmm_o3d import TransformationEstimationForAdaptiveGMM, register_points

SUPPORT = Path(__file__).parents[1] / "support"
ENVIRONMENT = os.environ | {"NUMBA_NUM_THREADS": "2", "OMP_WAIT_POLICY": "passive"}
# A hang is what is looked for; a busy machine that compiles first is not one.
PATIENCE_S = 240

# What the scripts below begin with: a registration large enough to run on two threads, and its bits.
PRELUDE = """
import os, sys
sys.path.insert(0, {support!r})
import numpy as np
import open3d as o3d
import adagmm_o3d
from mixtures import random_pose
from shapes import bumpy, move

rng = np.random.default_rng(0)
T = random_pose(rng, 3, angle=0.3, distance=0.2)
points = bumpy(rng, 4000, 3)
source, target = points[:2000], move(points[2000:], T)


def bits(_=None):
    result = adagmm_o3d.register_points(source, target)
    return result.transformation.tobytes() + result.row_weights.tobytes()


def cloud_bits(_=None):
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(p)) for p in (source, target)]
    result = adagmm_o3d.registration_adaptive_gmm(*clouds, 0.1)
    counted = np.array([result.fitness, result.inlier_rmse])
    return result.transformation.tobytes() + np.asarray(result.correspondence_set).tobytes() + counted.tobytes()
"""


def script(body):
    return PRELUDE.format(support=str(SUPPORT)) + textwrap.dedent(body)


def run(body, *, code=0, file=None):
    """Output of a Python process that runs the prelude and `body`, killed with all its children if it hangs."""
    arguments = [sys.executable, "-c", script(body)]
    if file is not None:  # spawned children import the main module from a file
        file.write_text(script(body))
        arguments = [sys.executable, str(file)]
    process = subprocess.Popen(
        arguments,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        out, err = process.communicate(timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        out, err = process.communicate()
        pytest.fail(f"hung after {PATIENCE_S} s; it had said {out!r} and {err!r}")
    assert process.returncode == code, err
    return out


@pytest.mark.parametrize("rule", ["posterior", "nearest"])
def test_threads_at_once_get_the_bits_of_one_alone(rule):
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule)
    problems = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        dimension = 2 + seed % 2
        points = bumpy(rng, 1600, dimension)
        T = random_pose(rng, dimension, angle=0.3, distance=0.2)
        problems.append((points[:800], move(points[800:], T)))

    def bits(problem):
        result = register_points(*problem, estimation_method=method)
        return result.transformations.tobytes() + result.sigmas.tobytes() + result.row_weights.tobytes()

    alone = [bits(problem) for problem in problems]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(bits, problems * 3))
    assert together == alone * 3


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_child_forked_after_use_gets_the_same_bits():
    out = run(
        """
        here = bits(), cloud_bits()
        for _ in range(2):  # a child, and its child
            pid = os.fork()
            if pid:
                _, status = os.waitpid(pid, 0)
                if os.waitstatus_to_exitcode(status):
                    os._exit(1)
                break
            if (bits(), cloud_bits()) != here:
                os._exit(1)
        else:
            os._exit(0)
        if (bits(), cloud_bits()) != here:
            os._exit(1)
        print("same", flush=True)
        os._exit(0)
        """
    )
    assert out.split() == ["same", "same"]


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_pool_of_forked_workers_gets_the_same_bits():
    out = run(
        """
        import multiprocessing
        here = bits()
        with multiprocessing.get_context("fork").Pool(2) as pool:
            print(pool.map(bits, range(4)) == [here] * 4)
        """
    )
    assert out.split() == ["True"]


@pytest.mark.slow
def test_a_pool_of_spawned_workers_gets_the_same_bits(tmp_path):
    out = run(
        """
        import multiprocessing
        if __name__ == "__main__":
            here = bits()
            with multiprocessing.get_context("spawn").Pool(1) as pool:
                print(pool.map(bits, range(2)) == [here] * 2)
        """,
        file=tmp_path / "spawning.py",
    )
    assert out.split() == ["True"]


@pytest.mark.slow
def test_a_child_forked_before_first_use_keeps_its_threads():
    out = run(
        """
        import numba
        pid = os.fork()
        if pid == 0:
            bits()
            print(numba.get_num_threads(), flush=True)
            os._exit(0)
        os.waitpid(pid, 0)
        """
    )
    assert out.split() == ["2"]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals are sent differently on Windows")
def test_ctrl_c_ends_a_long_registration():
    body = """
    import signal
    signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it
    many = bumpy(rng, 200_000, 3)
    bits()
    def beat(values):
        print(values["iteration_index"], flush=True)
    for _ in range(1000):
        adagmm_o3d.register_points(many, many + 0.01, callback_after_iteration=beat)
    """
    process = subprocess.Popen(
        [sys.executable, "-c", script(body)],
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        for _ in range(30):
            assert process.stdout.readline().strip().isdigit()
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        _, err = process.communicate(timeout=PATIENCE_S)
        took = time.monotonic() - sent
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == -signal.SIGINT
    assert err.rstrip().endswith("KeyboardInterrupt")
    assert took < 20.0


def test_an_import_brings_in_nothing_that_is_not_needed():
    code = """
    import sys, time
    import open3d
    before, start = set(sys.modules), time.perf_counter()
    import adagmm_o3d
    seconds = time.perf_counter() - start
    print(*sorted(set(sys.modules) - before))
    print(f"{seconds:.2f} s", file=sys.stderr)
    """
    process = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=True,
    )
    modules = process.stdout.split()
    print("import of adagmm_o3d after open3d:", process.stderr.strip())
    assert "adagmm_o3d.array_registration" in modules
    unwanted = ("rerun", "cv2", "scipy", "matplotlib", "yaml", "rich", "numba", "llvmlite", "hypothesis")
    assert not [m for m in modules if m.startswith(unwanted)]
