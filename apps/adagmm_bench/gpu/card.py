"""The graphics card, and what it could do at most."""

from __future__ import annotations

from dataclasses import dataclass

# float32 lanes of a multiprocessor by compute capability (CUDA C++ Programming Guide, "Arithmetic Instructions").
LANES = {(7, 5): 64, (8, 0): 64, (8, 6): 128, (8, 7): 128, (8, 9): 128, (9, 0): 128, (10, 0): 128, (12, 0): 128}


@dataclass(frozen=True)
class Card:
    """peak : float32 operations a second at the highest clock, a fused multiplication and addition counting as two.

    None for a compute capability that LANES does not know.
    """

    name: str
    capability: tuple[int, int]
    multiprocessors: int
    clock_hz: float

    @property
    def peak(self) -> float | None:
        lanes = LANES.get(self.capability)
        return None if lanes is None else 2.0 * lanes * self.multiprocessors * self.clock_hz

    def __str__(self) -> str:
        peak = "unknown peak" if self.peak is None else f"{self.peak / 1e12:.1f} TFLOP/s float32"
        capability = ".".join(map(str, self.capability))
        return (
            f"{self.name}, compute capability {capability}, {self.multiprocessors} multiprocessors at up to "
            f"{self.clock_hz / 1e6:.0f} MHz, {peak}"
        )


def current_card() -> Card:
    """The card that the kernels run on; only where there is one."""
    from numba import cuda

    from adagmm_o3d.kernels.cuda.availability import device_name

    device = cuda.get_current_device()
    major, minor = map(int, device.compute_capability)
    return Card(device_name(), (major, minor), int(device.MULTIPROCESSOR_COUNT), 1e3 * float(device.CLOCK_RATE))
