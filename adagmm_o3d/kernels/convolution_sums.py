"""The E-step on convolved Gaussians, in parallel: `convolved_pass` for bands of the source."""

from numba import njit, prange

from .compiling import F0, KERNEL_FLAGS, source_stamp
from .convolved_pass import convolved_pass
from .culling import CLUSTER


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**KERNEL_FLAGS)
    def convolution_sums(pose, source, target, tiles, kind, uniform, mutuality, columns, partials, densities):
        """Fill `partials` (bands, TOTAL_SUMS), `columns` (bands, N) and `densities` (M,); see `convolved_pass`."""
        _ = stamp
        bands = partials.shape[0]
        clusters = (source[0].shape[1] + CLUSTER - 1) // CLUSTER
        for band in prange(bands):
            partials[band] = 0.0
            columns[band] = F0
            convolved_pass(
                pose, source, target, tiles, kind, uniform, mutuality,
                (band * clusters // bands, (band + 1) * clusters // bands),
                columns[band], partials[band], densities,
            )  # fmt: skip

    return convolution_sums


convolution_sums = _build(source_stamp())
