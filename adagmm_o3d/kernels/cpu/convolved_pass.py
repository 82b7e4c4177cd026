"""One pass over pairs weighed by convolved Gaussians, N(d; 0, Σx + R Σy Rᵀ): a pair weighs what the density of x - y is
at zero.

Unlike the paper's weights these are shares of a likelihood, so a source point's weights can be divided by the density
of the target mixture plus a uniform one (the points without a partner): the posterior of EM. The same is done for the
target points by a factor for each, from the densities of a pass before.

A cluster of source points meets only the target points that it can reach. These are copied together first, so that the
loop over pairs stays dense whatever the order of the points.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from adagmm_o3d.kernels.cpu.compiling import F0, F1, FLAGS, SERIAL_KERNEL_FLAGS, source_stamp
from adagmm_o3d.kernels.cpu.convolved_rows import (
    Cluster,
    Hues,
    densities_full,
    densities_isotropic,
    densities_planar,
    moments_full,
    moments_isotropic,
    moments_planar,
)
from adagmm_o3d.kernels.cpu.culling import BLOCK, CLUSTER, GROUP, RUN, TILE, Box, Boxes, cluster_box, largest, reach
from adagmm_o3d.kernels.cpu.moving import move_symmetric
from adagmm_o3d.kernels.cpu.normal_equations import add_rows
from adagmm_o3d.kernels.cpu.tiles import Tiles
from adagmm_o3d.kernels.layout import DENSITY, MATRIX, ROW_SUMS, SHARE, TOTAL_MATCHED, TOTAL_SUMS, X

# Points are filled up to a multiple of this, the floats of the widest vector register, with points of no weight: no
# pair is left over for scalar code. A tile is as long.
LANES = TILE
# Rows a large power of two apart would all fall on the same few lines of the cache.
SAME_LINES = 256
STRIDE = RUN + 2 * LANES
# So few tiles of a group are all taken as soon as one is in reach: to pick points costs more than the pairs.
FEW_TILES = 8
# Numba compiles a function anew for a literal.
ZERO, ONE = np.int64(0), np.int64(1)


class PassSource(NamedTuple):
    """A source at σ: its pose (12,), the rows of [R | t]; points (3, M), matrices (1 or 6, M) packed, weights (M,)
    float64 and weights32, largest variances (M,), and by how many powers of two a weight may fall, bits (M,)."""

    pose: NDArray[np.float32]
    points: NDArray[np.float32]
    matrices: NDArray[np.float32]
    weights: NDArray[np.float64]
    weights32: NDArray[np.float32]
    variances: NDArray[np.float32]
    bits: NDArray[np.float32]


class PassTarget(NamedTuple):
    """A target at σ: see `pack`; largest variances and bits (N,); its tiles, with variances at σ."""

    packed: NDArray[np.float32]
    variances: NDArray[np.float32]
    bits: NDArray[np.float32]
    tiles: Tiles


class Kind(NamedTuple):
    """Which of the loops: in the plane, on multiples of the identity, for densities alone."""

    planar: bool
    isotropic: bool
    densities_only: bool


class Weighing(NamedTuple):
    """What turns the density of a pair into its weight: `uniform`, that of the points without a partner, and by which
    power the posterior seen from the target counts, `mutuality`."""

    uniform: float
    mutuality: float


class PassSums(NamedTuple):
    """What a pass fills.

    columns : (padded N,) float32 the density of a band at the target points, times their weight, if densities_only.
    totals : (TOTAL_SUMS,) the sums of a band, if not.   densities : (M,) the target's density at the source points.
    Of all bands columns and totals have one axis more in front.
    """

    columns: NDArray[np.float32]
    totals: NDArray[np.float64]
    densities: NDArray[np.float64]


def pack(
    points: NDArray[np.float32], weights: NDArray[np.floating], matrix_rows: int, hue_rows: int = 0
) -> NDArray[np.float32]:
    """(5 + matrix_rows + hue_rows, padded n) target for `convolved_pass`, see `layout`: coordinates and weights, room
    for the matrices at σ, factors of one, room for colours."""
    n = points.shape[1]
    padded = -(-n // LANES) * LANES
    padded += LANES if padded % SAME_LINES == 0 else 0
    factor = MATRIX + matrix_rows
    packed = np.zeros((factor + 1 + hue_rows, padded), np.float32)
    packed[X:SHARE, :n], packed[SHARE, :n], packed[factor] = points, weights, 1.0
    packed[[MATRIX, MATRIX + 3, MATRIX + 5] if matrix_rows > 1 else MATRIX, n:] = 1.0
    return packed


@njit(**FLAGS)
def run_rows(target, i, j, kind, cluster, hue, columns, rows):
    """The pairs of a cluster with packed target points i..j."""
    planar, isotropic, densities_only = kind
    if densities_only:
        if isotropic:
            densities_isotropic(target, i, j, planar, cluster, hue, columns, rows)
        elif planar:
            densities_planar(target, i, j, cluster, hue, columns, rows)
        else:
            densities_full(target, i, j, cluster, hue, columns, rows)
    elif isotropic:
        moments_isotropic(target, i, j, planar, cluster, hue, rows)
    elif planar:
        moments_planar(target, i, j, cluster, hue, rows)
    else:
        moments_full(target, i, j, cluster, hue, rows)


@njit(**FLAGS)
def gather(target, index, count, isotropic, near):
    """Copy the `count` target points of `index` together, filled up with points of no weight; how many they are now."""
    padded = (count + LANES - 1) // LANES * LANES
    for r in range(target.shape[0]):
        for i in range(count):
            near[r, i] = target[r, np.uint64(index[i])]
        for i in range(count, padded):
            near[r, i] = F0
    # The matrix of a point that weighs nothing only has to be invertible: the identity.
    for i in range(count, padded):
        near[MATRIX, i] = F1
        if not isotropic:
            near[MATRIX + 3, i] = F1
            near[MATRIX + 5, i] = F1
    return padded


@njit(**FLAGS)
def take_hues(hues, first, last, hue):
    """Put the colours of source points first..last, if any, into `hue`."""
    if hues is not None:
        for k in range(last - first):
            for i in range(3):
                hue.colours[i, k] = hues.colours[i, first + k]


@njit(**FLAGS)
def points_in_reach(first, last, box, points, beyond, beyond_points, index, count):
    """Put the points that a source cluster can reach, of those of tiles first..last whose `beyond` is negative, behind
    the first `count` of `index`; how many they are now. See `culling.reach`; `points` are boxes without extent."""
    for t in range(first, last):
        if beyond[t - first] < F0:
            n0, n1 = t * TILE, min(points.bits.shape[0], (t + 1) * TILE)
            reach(n0, n1, box, points, beyond_points)
            for n in range(n0, n1):
                index[count] = n
                count += beyond_points[n - n0] < F0
    return count


@njit(**FLAGS)
def convolved_pass(band, bands, source, hues, target, kind, weighing, sums):
    """The pairs of one of several bands of the source with all of the target, serially.

    source, target, kind, weighing, sums : `PassSource` and so on.
    hues : colours of the source points; None where these do not count, for which Numba compiles the loops anew.
    """
    pose, points, matrices, weights, weights32, variances, bits = source
    packed, target_variances, target_bits, tiles = target
    uniform, mutuality = weighing
    columns, total, densities = sums
    tile_lo, tile_hi, tile_variance, tile_bits, group_lo, group_hi, group_variance, group_bits = tiles
    _, isotropic, densities_only = kind
    m_all = points.shape[1]
    tile_count, group_count = tile_lo.shape[1], group_lo.shape[1]
    groups_met = Boxes(group_lo, group_hi, group_variance, group_bits)
    tiles_met = Boxes(tile_lo, tile_hi, tile_variance, tile_bits)
    points_met = Boxes(packed, packed, target_variances, target_bits)
    y = np.empty((3, CLUSTER), np.float32)
    y_block = np.empty((3, BLOCK * CLUSTER), np.float32)
    lo = np.empty(3, np.float32)
    hi = np.empty(3, np.float32)
    own = np.empty(CLUSTER, np.float32)
    hue = None if hues is None else Hues(np.empty((3, CLUSTER), np.float32), hues.cap)
    turned = np.empty((CLUSTER, 6), np.float32)
    rows = np.empty((ROW_SUMS, CLUSTER), np.float64)
    amplitudes = np.empty(CLUSTER, np.float64)
    beyond, beyond_points = np.empty(GROUP, np.float32), np.empty(TILE, np.float32)
    beyond_groups, groups = np.empty(group_count, np.float32), np.empty(group_count, np.int64)
    index = np.empty(RUN, np.uint32)
    near = np.empty((packed.shape[0], STRIDE), np.float32)
    near_columns = np.empty(RUN, np.float32)
    for i in range(TOTAL_SUMS):
        total[i] = 0.0
    if densities_only:
        for n in range(len(columns)):
            columns[n] = F0
    clusters = (m_all + CLUSTER - 1) // CLUSTER
    first_cluster, last_cluster = band * clusters // bands, (band + 1) * clusters // bands
    met = 0
    for cluster in range(first_cluster, last_cluster):
        if (cluster - first_cluster) % BLOCK == 0:
            m0, m1 = cluster * CLUSTER, min(m_all, min(cluster + BLOCK, last_cluster) * CLUSTER)
            cluster_box(pose, points, m0, m1, y_block, lo, hi)
            box = Box(lo, hi, largest(variances, m0, m1), largest(bits, m0, m1))
            reach(ZERO, group_count, box, groups_met, beyond_groups)
            met = 0
            for g in range(group_count):
                groups[met] = g
                met += beyond_groups[g] < F0
        m0 = cluster * CLUSTER
        m1 = min(m_all, m0 + CLUSTER)
        cluster_box(pose, points, m0, m1, y, lo, hi)
        box = Box(lo, hi, largest(variances, m0, m1), largest(bits, m0, m1))
        rows[:] = 0.0
        for k in range(m1 - m0):
            own[k] = weights32[m0 + k]
            move_symmetric(pose, matrices, F1, isotropic, m0 + k, turned, k)
        take_hues(hues, m0, m1, hue)
        members = Cluster(m1 - m0, y, turned, own)
        count = ZERO
        i = 0
        while i < met or count > 0:
            # The loops over pairs have one place to be called from, or they would be compiled for each.
            gathered = i == met or count > RUN - GROUP * TILE
            if gathered:
                n0, n1 = 0, gather(packed, index, count, isotropic, near)
                run, run_columns = near, near_columns
                if densities_only:
                    for n in range(n1):
                        near_columns[n] = F0
            else:
                g = groups[i]
                i += 1
                if not reach(g, g + 1, box, groups_met, beyond):
                    continue
                first, last = g * GROUP, min(tile_count, (g + 1) * GROUP)
                hits = reach(first, last, box, tiles_met, beyond)
                if hits < last - first and (hits == 0 or last - first > FEW_TILES):
                    if hits > 0:
                        count = points_in_reach(first, last, box, points_met, beyond, beyond_points, index, count)
                    continue
                n0, n1 = first * TILE, last * TILE
                run, run_columns = packed, columns
            run_rows(run, n0, n1, kind, members, hue, run_columns, rows)
            if gathered:
                if densities_only:
                    for k in range(count):
                        columns[np.uint64(index[k])] += near_columns[k]
                count = ZERO
        for k in range(m1 - m0):
            m = m0 + k
            density = rows[DENSITY, k]
            densities[m] = density
            if not densities_only:
                posterior = 1.0 / (density + uniform)
                total[TOTAL_MATCHED] += weights[m] * density * posterior
                amplitudes[k] = weights[m] * posterior
                if mutuality > 0.0:
                    amplitudes[k] *= (posterior * uniform) ** -mutuality
        if not densities_only:
            add_rows(rows, m1 - m0, amplitudes, y, total)


def _build(stamp):
    """The kernel that is called from Python; `stamp` keeps its cache fresh."""

    @njit(**SERIAL_KERNEL_FLAGS)
    def convolution_sums(first, last, source, hues, target, kind, weighing, sums):
        """Bands first..last of `sums`; see `convolved_pass`."""
        _ = stamp
        bands = sums.totals.shape[0]
        for band in range(first, last):
            own = PassSums(sums.columns[band], sums.totals[band], sums.densities)
            convolved_pass(np.int64(band), bands, source, hues, target, kind, weighing, own)

    return convolution_sums


convolution_sums = _build(source_stamp())
