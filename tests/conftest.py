"""Shared by all tests: a calm OpenMP, repeatable properties, and the tests' own helpers importable by name."""

import os
import sys
from pathlib import Path

from hypothesis import settings

os.environ.setdefault("OMP_WAIT_POLICY", "passive")
sys.path.insert(0, str(Path(__file__).parent / "support"))

if os.environ.get("NUMBA_DISABLE_JIT", "0") != "0":
    # Instructions that only the compiler knows.
    import numpy as np

    from adagmm_o3d.kernels.cpu import exp2

    exp2._nearest_whole = np.rint
    exp2._as_int32 = lambda value: np.float32(value).view(np.int32)
    exp2._as_float32 = lambda bits: np.int32(bits).view(np.float32)

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")
