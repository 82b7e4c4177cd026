"""Fresh processes: importing, the first registration with a warm cache, and compiling everything from nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile

import numpy as np

from adagmm_bench.speed.measurement import Measurement
from adagmm_o3d.errors import AdaGMMError

IMPORT_GOAL, FIRST_GOAL, COLD_GOAL = 0.3, 2.0, 30.0  # seconds
IMPORTS = """
import time
import open3d
t = time.perf_counter()
import adagmm_o3d
print(time.perf_counter() - t)
"""
FIRST = """
import time
import numpy as np
from adagmm_o3d import register_points
points = np.random.default_rng(0).normal(size=(1000, 3))
t = time.perf_counter()
register_points(points[:900], points[100:])
print(time.perf_counter() - t)
"""


class StartupError(AdaGMMError, RuntimeError):
    """A fresh process did not do what it was started for."""


def startup(repeats: int) -> list[Measurement]:
    """Seconds only: they say more about the disk than about the code, so none is compared with recorded ones."""
    imports = float(np.median([_printed_seconds(IMPORTS) for _ in range(repeats)]))
    _printed_seconds(FIRST)  # fills the cache
    first = float(np.median([_printed_seconds(FIRST) for _ in range(repeats)]))
    with tempfile.TemporaryDirectory() as empty:
        cold = _printed_seconds(FIRST, NUMBA_CACHE_DIR=empty)
    return [
        Measurement("startup", "import, beyond Open3D", imports, "s", goal=IMPORT_GOAL),
        Measurement("startup", "first registration, cache warm", first, "s", goal=FIRST_GOAL),
        Measurement("startup", "first registration, nothing compiled", cold, "s", goal=COLD_GOAL),
    ]


def _printed_seconds(program: str, **environment: str) -> float:
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise StartupError(f"startup: a fresh Python ended with code {done.returncode}: {last}")
    return float(done.stdout.split()[-1])
