"""How the CPU kernels are compiled: the flags that make them vectorise, and a cache that cannot go stale."""

import hashlib
import math
from pathlib import Path

import numpy as np
from numba import njit

from . import gaussian

# Each of these is needed for vector code, and none assumes that there are no NaN or infinities.
FAST = {"reassoc", "contract", "arcp", "nsz"}
FLAGS = {"fastmath": FAST, "error_model": "numpy"}
KERNEL_FLAGS = {"parallel": True, "cache": True, "nogil": True, **FLAGS}
# exp(-q/2) = 2**-(LOG2_SCALE q): the kernels know only powers of two.
LOG2_SCALE = 0.5 / math.log(2.0)
F0, F1 = np.float32(0.0), np.float32(1.0)


def source_stamp() -> int:
    """A hash of every file of this folder.

    Numba's cache knows only the file a kernel is in. Each kernel has this number as a free variable, which is part of
    the cache key, so that an edit in a file it merely calls into compiles it anew.
    """
    files = sorted(Path(__file__).parent.glob("*.py"))
    return int(hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:15], 16)


# The formulas for the CPU.
formulas = gaussian.build(njit(**FLAGS))
