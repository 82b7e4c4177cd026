"""The CPU kernels as plain Python: what Numba compiles is also right uncompiled, and a coverage tool sees its lines."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent
FILES = (
    "test_kernels.py",
    "test_search_kernel.py",
    "test_acceleration.py",
    "test_culling.py",
    "test_score_sums.py",
    "test_pose_covariance.py",
)
# Fast enough by the interpreter; the others are about speed, threads or large clouds.
CHOSEN = (
    "(test_kernels and not threads and not 500-2000 and not far_points) or test_search_kernel or test_acceleration"
    " or test_culling or test_score_sums or (moments and 0.5-anisotropic)"
)


def test_kernels_pass_their_tests_uncompiled():
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *(TESTS / f for f in FILES), "-k", CHOSEN],
        cwd=TESTS.parent,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, f"{done.stdout[-8000:]}\n{done.stderr[-2000:]}"
    assert " passed" in done.stdout
