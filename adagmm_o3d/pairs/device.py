"""Which device evaluates the pairs of two mixtures."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from adagmm_o3d.errors import DeviceError
from adagmm_o3d.kernels.cuda.availability import device_name, obstacle
from adagmm_o3d.mixtures.mixture import Mixture, make_mixture

if TYPE_CHECKING:
    from adagmm_o3d.pairs.cpu_pairs import PairLoop
    from adagmm_o3d.pairs.cuda_pairs import CudaPairLoop

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
    if source.on_device or takes_gpu(device, len(source) * len(target)):
        from adagmm_o3d.pairs.cuda_pairs import CudaPairLoop

        return CudaPairLoop(source, target)
    from adagmm_o3d.pairs.cpu_pairs import PairLoop

    return PairLoop(source, target)


def takes_gpu(device: str, pairs: int) -> bool:
    """Whether so many pairs are evaluated on a GPU, for a `device` that has been checked."""
    if device != "auto" or pairs < CROSSING_PAIRS:
        return device == "cuda"
    reason = obstacle()
    _say_once(reason)
    return reason is None


def mixture_maker(device: str, source: ArrayLike, target: ArrayLike) -> Callable[..., Mixture]:
    """What makes mixtures of two clouds: `make_mixture`, or where a GPU takes their pairs its twin there.

    What is no array of points is left to be refused by either.
    """
    try:
        pairs = math.prod(np.shape(cloud)[0] for cloud in (source, target))
    except (IndexError, TypeError, ValueError):
        return make_mixture
    if not takes_gpu(device, pairs):
        return make_mixture
    from adagmm_o3d.mixtures.device_mixture import uploaded_mixture

    return uploaded_mixture


@cache
def _say_once(reason: str | None) -> None:
    picked = f"the GPU {device_name()}" if reason is None else f"the CPU, as {reason}"
    _log.info("device: 'auto' picked %s for %d pairs and more", picked, CROSSING_PAIRS)
