"""Whether the CUDA kernels can run here, and if not, why. Asking imports Numba, and `numba.cuda` where it is usable."""

from __future__ import annotations

import importlib.util
from functools import cache

# What the kernels are tested to compile for, from here on.
LEAST_CAPABILITY = (7, 5)
INSTALL = "pip install 'adagmm-o3d[cuda]'"


@cache
def obstacle() -> str | None:
    """What keeps the CUDA kernels from running here, as one line; None where they can run."""
    if simulated():
        return None
    if (missing := missing_front_end()) is not None:
        return missing
    from numba import cuda

    if not cuda.is_available():
        return "no CUDA GPU or no driver for it was found"
    capability = tuple(cuda.get_current_device().compute_capability)
    if capability < LEAST_CAPABILITY:
        found, wanted = (".".join(map(str, version)) for version in (capability, LEAST_CAPABILITY))
        return f"the GPU has compute capability {found}, at least {wanted} is needed"
    return None


def missing_front_end() -> str | None:
    """Why there is no usable `numba.cuda`; None where there is one, with or without a GPU.

    The one inside Numba is deprecated and broken, only its simulator works. NVIDIA's numba-cuda takes its place by a
    .pth file, which `pip install --target` leaves unread.
    """
    if simulated():
        return None
    if importlib.util.find_spec("numba_cuda") is None:
        return f"numba-cuda is not installed; {INSTALL}"
    try:
        from numba import cuda
    except (ImportError, AttributeError) as error:
        return f"numba-cuda cannot be imported ({error}); {INSTALL}"
    if getattr(cuda, "implementation", None) != "NVIDIA":
        return "numba-cuda is installed, but its .pth file was not read, so numba.cuda is not NVIDIA's; use a venv"
    return None


def simulated() -> bool:
    """Whether Numba's CUDA simulator stands in for a GPU (NUMBA_ENABLE_CUDASIM=1 before Numba is imported)."""
    from numba.core import config

    return bool(config.ENABLE_CUDASIM)


def device_name() -> str:
    """The name of the GPU in use; only where there is no `obstacle`."""
    if simulated():
        return "CUDA simulator"
    from numba import cuda

    return str(cuda.get_current_device().name)
