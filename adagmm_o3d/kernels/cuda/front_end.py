"""Numba's CUDA as the kernels see it, and how they are compiled. Importing this needs numba-cuda or the simulator."""

from __future__ import annotations

import hashlib
import math
import warnings
from pathlib import Path

import numpy as np
from numba import cuda
from numba.core.errors import NumbaPerformanceWarning

from adagmm_o3d.errors import DeviceError
from adagmm_o3d.kernels.cpu import culling
from adagmm_o3d.kernels.cpu.cache_folder import find_a_folder
from adagmm_o3d.kernels.cuda.availability import missing_front_end, simulated
from adagmm_o3d.kernels.formulas import build

if (_missing := missing_front_end()) is not None:
    raise DeviceError(f"device: 'cuda' cannot be used here: {_missing}")

# A small cloud fills no GPU, and Numba need not say so.
warnings.filterwarnings("ignore", message="Grid size", category=NumbaPerformanceWarning)

# Every block has one thread for each point of a tile: one it works for, and one of those it reads at a time. The
# simulator makes an operating system thread of each; a few are enough to see what is wrong.
TILE = 8 if simulated() else culling.TILE
F0, F1 = np.float32(0.0), np.float32(1.0)
SIMULATED = simulated()


def source_stamp() -> int:
    """A hash of every file that a kernel is made of: Numba's cache knows only the one that the kernel is in."""
    here = Path(__file__).parent
    files = sorted([*here.glob("*.py"), *here.parent.glob("*.py")])
    return int(hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:15], 16)


def exact(function):
    """A function that kernels call, rounded as IEEE 754 has it. The simulator calls a plain one as well, and sooner."""
    return function if simulated() else cuda.jit(device=True)(function)


def fast(function):
    """A function that kernels call, with the GPU's own 2**x, 1/x and √x (relative error below 3e-7)."""
    return function if simulated() else cuda.jit(device=True, fastmath=True)(function)


def _kept() -> bool:
    """Whether compiled kernels can be kept on disk."""
    from numba.cuda.dispatcher import CUDACache

    return find_a_folder(CUDACache)


def kernel(function):
    """A function that is launched; kept on disk once it is compiled. A launch hands over arrays and numbers one by one,
    however many they are."""
    return cuda.jit(function) if simulated() else cuda.jit(cache=_kept())(function)


def fast_kernel(function):
    """The same for one that calls `fast` functions: how float32 rounds is settled for a kernel as a whole."""
    return cuda.jit(function) if simulated() else cuda.jit(cache=_kept(), fastmath=True)(function)


@fast
def inverse_root(x):
    """1/√x of a float32: one instruction of the GPU, which the compiler does not find by itself."""
    return F1 / math.sqrt(x) if SIMULATED else cuda.libdevice.rsqrtf(x)


@exact
def exact_inverse_root(x):
    """1/√x of a float64, rounded twice."""
    return 1.0 / math.sqrt(x)


@fast
def power_of_two(x):
    """2**x of a float32."""
    return math.exp2(x)


@exact
def exact_power_of_two(x):
    """2**x of a float64."""
    return math.exp2(x)


# The formulas for the GPU.
formulas = build(fast, inverse_root, power_of_two)
exact_formulas = build(exact, exact_inverse_root, exact_power_of_two)
