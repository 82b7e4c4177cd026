"""Points of a table (see `inspecting`) put into the kernels' order and tiles, normalised on the way."""

from numba import float32

from adagmm_o3d.kernels.cuda.clouds.inspecting import COVARIANCE, LARGEST, VARIANCE
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda, exact, exact_formulas, kernel, source_stamp
from adagmm_o3d.kernels.cuda.tiles import BOX_BITS, BOX_VARIANCE, extreme
from adagmm_o3d.kernels.cuda.tuples import column_storer
from adagmm_o3d.kernels.formulas import LOG2_SCALE
from adagmm_o3d.kernels.layout import MATRIX, SHARE

adjugate, dot = exact_formulas.adjugate, exact_formulas.dot
store_packed = column_storer(6, exact)

# The highest number of a cell along an axis, ten bits; see `kernels.cpu.tiles.morton_order`.
LAST_CELL = 1023


@exact
def spread_bits(v):
    """Ten bits, two zeros after each."""
    v = (v | (v << 16)) & 0x030000FF
    v = (v | (v << 8)) & 0x0300F00F
    v = (v | (v << 4)) & 0x030C30C3
    return (v | (v << 2)) & 0x09249249


def _build_codes(stamp):
    @kernel
    def morton_codes(points, centre, scale, low, cells, codes):
        """One thread for each point: where it lies on a Z-curve through the normalised cloud.

        centre, low : (3,) float64 tuples, `low` the least normalised coordinates.   cells : cells a unit of length.
        codes : (n,) uint32, overwritten.
        """
        _ = stamp
        i = cuda.blockIdx.x * TILE + cuda.threadIdx.x
        if i < points.shape[1]:
            code = 0
            for k in range(3):
                cell = int(((points[k, i] - centre[k]) / scale - low[k]) * cells)
                code |= spread_bits(min(cell, LAST_CELL)) << k
            codes[i] = code

    return morton_codes


def _build_gather(stamp):
    @kernel
    def gather(points, index, chosen):
        """The chosen columns of a table: `chosen` (rows, k), for `index` (k,)."""
        _ = stamp
        i = cuda.blockIdx.x * TILE + cuda.threadIdx.x
        if i < index.shape[0]:
            for k in range(chosen.shape[0]):
                chosen[k, i] = points[k, index[i]]

    return gather


def _build_pack(precise, isotropic, stamp):
    """The kernel for precisions (`precise`) or covariances, of one kind of matrices."""

    @kernel
    def pack(points, order, centre, scale, unit, least, most, shares, bits, tiles, boxes):
        """One block for each tile; see `tiles.point_tiles` and `tiles.boxes`.

        order : (n,) the places in the table, in the order of the tiles.   centre, scale, unit, least, most : of
        `normalisation.Normalisation`, and the range of relative variances.   shares, bits : (tiles, TILE) float32.
        tiles : (tiles, 4 + 1 or 6, TILE) and boxes : (tiles, 8) float32, overwritten.
        """
        _ = stamp
        corners = cuda.shared.array((TILE, 8), float32)
        tile = cuda.blockIdx.x
        t = cuda.threadIdx.x
        i = order[min(tile * TILE + t, order.shape[0] - 1)]
        for k in range(3):
            coordinate = float32((points[k, i] - centre[k]) / scale)
            tiles[tile, k, t] = coordinate
            corners[t, k] = coordinate
            corners[t, k + 3] = coordinate
        tiles[tile, SHARE, t] = shares[tile, t]
        relative = points[VARIANCE, i] / unit
        factor = min(max(relative, least), most) / relative / unit
        corners[t, BOX_VARIANCE] = points[LARGEST, i] * factor / LOG2_SCALE
        corners[t, BOX_BITS] = bits[tile, t]
        c0 = points[COVARIANCE, i] * factor
        if isotropic:
            tiles[tile, MATRIX, t] = LOG2_SCALE / c0 if precise else c0 / LOG2_SCALE
        else:
            c1, c2 = points[COVARIANCE + 1, i] * factor, points[COVARIANCE + 2, i] * factor
            c3, c4 = points[COVARIANCE + 3, i] * factor, points[COVARIANCE + 4, i] * factor
            c5 = points[COVARIANCE + 5, i] * factor
            in_powers_of_two = 1.0 / LOG2_SCALE
            if precise:
                a0, a1, a2, a3, a4, a5 = adjugate(c0, c1, c2, c3, c4, c5)
                in_powers_of_two = LOG2_SCALE / dot(c0, c1, c2, a0, a1, a2)
                c0, c1, c2, c3, c4, c5 = a0, a1, a2, a3, a4, a5
            c0, c1, c2 = c0 * in_powers_of_two, c1 * in_powers_of_two, c2 * in_powers_of_two
            c3, c4, c5 = c3 * in_powers_of_two, c4 * in_powers_of_two, c5 * in_powers_of_two
            store_packed(tiles[tile], MATRIX, t, (c0, c1, c2, c3, c4, c5))
        cuda.syncthreads()
        if t < 8:
            boxes[tile, t] = extreme(corners, t)

    return pack


morton_codes = _build_codes(source_stamp())
gather = _build_gather(source_stamp())
pack_precisions_isotropic = _build_pack(True, True, source_stamp())
pack_precisions = _build_pack(True, False, source_stamp())
pack_covariances_isotropic = _build_pack(False, True, source_stamp())
pack_covariances = _build_pack(False, False, source_stamp())
