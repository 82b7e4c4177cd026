"""CUDA kernels compiled to PTX and on to machine code without a GPU, and what the assembler says of them."""

import contextlib
import importlib.util
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace


@dataclass(frozen=True)
class Resources:
    """What one thread of a kernel takes; local memory is everything that found no register: arrays and spills."""

    registers: int
    local_bytes: int
    spilled_bytes: int
    shared_bytes: int


@contextlib.contextmanager
def assumed_capability(capability):
    """Functions that kernels call ask the driver what they are compiled for; here there is none to ask."""
    from numba.cuda import dispatcher

    asked = dispatcher.get_current_device
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=capability)
    try:
        yield
    finally:
        dispatcher.get_current_device = asked


def compile_to_ptx(kernel, signature, capability):
    """The PTX of a kernel, with the options it is launched with."""
    from numba import cuda

    with assumed_capability(capability):
        return cuda.compile_ptx(
            kernel.py_func, signature, cc=capability, fastmath=kernel.targetoptions.get("fastmath", False)
        )[0]


def find_ptxas():
    """The assembler: from the wheel nvidia-cuda-nvcc, which is as new as the compiler, or on PATH; else None."""
    spec = importlib.util.find_spec("nvidia")
    folders = [] if spec is None else list(spec.submodule_search_locations or [])
    from_wheel = (str(p) for folder in folders for p in Path(folder).glob("*/bin/ptxas"))
    return next(from_wheel, None) or shutil.which("ptxas")


def assemble(ptx, capability, folder):
    """What `ptxas` says of the only kernel in `ptx`; its complaint as an error where it refuses."""
    source = Path(folder, "kernel.ptx")
    source.write_text(ptx)
    arch = "sm_{}{}".format(*capability)
    done = subprocess.run(
        [find_ptxas(), "-v", f"-arch={arch}", str(source), "-o", str(source.with_suffix(".cubin"))],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"ptxas refuses {arch}: {done.stderr}")

    def largest(pattern):
        return max((int(n) for n in re.findall(pattern, done.stderr)), default=0)

    return Resources(
        registers=largest(r"Used (\d+) registers"),
        local_bytes=largest(r"(\d+) bytes stack frame"),
        spilled_bytes=largest(r"(\d+) bytes spill"),
        shared_bytes=largest(r"(\d+) bytes smem"),
    )
