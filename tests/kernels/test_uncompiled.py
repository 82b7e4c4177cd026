"""The CPU kernels as plain Python: what Numba compiles is also right uncompiled, and a coverage tool sees its lines."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

TESTS = Path(__file__).parents[1]
FILES = (
    "kernels/test_kernels.py",
    "kernels/test_em_kernel.py",
    "kernels/test_acceleration.py",
    "kernels/test_culling.py",
    "kernels/test_scores.py",
    "kernels/test_votes.py",
    "plugin/test_pose_covariance.py",
)
# Fast enough by the interpreter; the others are about speed, threads or large clouds.
CHOSEN = (
    "(test_kernels and not threads and not 500-2000 and not far_points) or test_em_kernel or test_acceleration"
    " or test_culling or test_scores or test_votes or (moments and 0.5-anisotropic)"
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
