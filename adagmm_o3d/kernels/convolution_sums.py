"""The E-step on convolved Gaussians: `convolved_pass` for bands of the source, which are independent of each other."""

import numpy as np
from numba import njit

from .compiling import SERIAL_KERNEL_FLAGS, source_stamp
from .convolved_pass import convolved_pass


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def convolution_sums(
        first, last, pose, source, target, tiles, kind, uniform, mutuality, columns, partials, densities
    ):
        """Bands first..last: fill `densities` (M,) and `partials` (bands, TOTAL_SUMS) or `columns` (bands, N); see
        `convolved_pass`."""
        _ = stamp
        bands = partials.shape[0]
        for band in range(first, last):
            convolved_pass(
                np.int64(band), bands, pose, source, target, tiles, kind, uniform, mutuality,
                columns[band], partials[band], densities,
            )  # fmt: skip

    return convolution_sums


convolution_sums = _build(source_stamp())
