"""Which device evaluates the pairs of two mixtures."""

from __future__ import annotations

import logging
from functools import cache
from typing import TYPE_CHECKING

from ..errors import DeviceError
from ..mixture import Mixture
from .cuda.availability import device_name, obstacle
from .pair_loop import PairLoop

if TYPE_CHECKING:
    from .cuda.pair_loop import CudaPairLoop

DEVICES = ("auto", "cpu", "cuda")
# From so many pairs on a pass is faster on a GPU: below, the time to launch its kernels, some tenths of a millisecond,
# is more than a few cores need for all pairs. An estimate; `adagmm-bench gpu` measures where it lies on a machine.
CROSSING_PAIRS = 10_000_000

_log = logging.getLogger("adagmm_o3d")


def check_device(device: str) -> None:
    """Raise DeviceError unless `device` is one of DEVICES and can be used here."""
    if not isinstance(device, str) or device not in DEVICES:
        raise DeviceError(f"device: expected one of {', '.join(map(repr, DEVICES))}, got {device!r}")
    if device == "cuda" and (reason := obstacle()) is not None:
        raise DeviceError(f"device: 'cuda' cannot be used here: {reason}")


def make_pair_loop(source: Mixture, target: Mixture, device: str) -> PairLoop | CudaPairLoop:
    """The pairs of two mixtures on the device asked for; "auto" takes a GPU where there is one and enough to do."""
    check_device(device)
    if source.on_device:
        device = "cuda"
    automatic = device == "auto" and len(source) * len(target) >= CROSSING_PAIRS
    if automatic:
        _say_once(obstacle())
    if device == "cuda" or (automatic and obstacle() is None):
        from .cuda.pair_loop import CudaPairLoop

        return CudaPairLoop(source, target)
    return PairLoop(source, target)


@cache
def _say_once(reason: str | None) -> None:
    picked = f"the GPU {device_name()}" if reason is None else f"the CPU, as {reason}"
    _log.info("device: 'auto' picked %s for %d pairs and more", picked, CROSSING_PAIRS)
