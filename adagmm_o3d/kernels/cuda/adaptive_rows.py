"""The paper's E-step on the GPU: the sums of every source point over the target, as in `kernels.cpu.adaptive_rows`."""

from numba import float32, int32

from adagmm_o3d.kernels.cuda.front_end import F0, F1, TILE, cuda, fast, fast_kernel, formulas, source_stamp
from adagmm_o3d.kernels.cuda.shared_tile import offset, packed_at, point_at
from adagmm_o3d.kernels.cuda.tiles import is_near, isotropic_matrix_of, packed_matrix_of, point_of
from adagmm_o3d.kernels.cuda.tuples import adder, column_storer
from adagmm_o3d.kernels.layout import FACTOR, ISOTROPIC_FACTOR, MATRIX, SHARE

adaptive_full, adaptive_isotropic, dot = formulas.adaptive_full, formulas.adaptive_isotropic, formulas.dot

# Sums of a source point: layout.WEIGHT to TORQUE. Of isotropic ones the precision is one number, and nothing turns.
ROWS, ISOTROPIC_ROWS = 14, 6
# Tiles summed in float32 before float64 takes over.
FLUSH = 4


@fast
def pair_full(x, j, y, b):
    """What the pair of source point y, its precision b, and target point j of the tile `x` adds to the sums of y."""
    d, a = offset(y, point_at(x, j)), packed_at(x, j)
    c, q, ux, uy, uz, tx, ty, tz = adaptive_full(
        x[j, SHARE], d.x, d.y, d.z, a.xx, a.xy, a.xz, a.yy, a.yz, a.zz, b.xx, b.xy, b.xz, b.yy, b.yz, b.zz
    )
    return (
        c, c * q,
        c * a.xx, c * a.xy, c * a.xz, c * a.yy, c * a.yz, c * a.zz,
        c * ux, c * uy, c * uz,
        c * tx, c * ty, c * tz,
    )  # fmt: skip


@fast
def pair_isotropic(x, j, y, b):
    """The same where every precision is a multiple of the identity: weight, energy, precision and pull."""
    d = offset(y, point_at(x, j))
    a = x[j, MATRIX]
    square = dot(d.x, d.y, d.z, d.x, d.y, d.z)
    c = adaptive_isotropic(x[j, SHARE], square, a, b)
    k = c * (a + b)
    return c, k * square, c * a, k * d.x, k * d.y, k * d.z


@fast
def unfolded(s):
    """Isotropic sums as those of ROWS."""
    weight, energy, precision, ux, uy, uz = s
    return weight, energy, precision, 0.0, 0.0, precision, 0.0, precision, ux, uy, uz, 0.0, 0.0, 0.0


def _build(isotropic, stamp):
    """The kernel for one kind of matrices; `stamp` keeps its cache fresh."""
    components = ISOTROPIC_FACTOR if isotropic else FACTOR  # a tile ends where a factor would be
    matrix_of = isotropic_matrix_of if isotropic else packed_matrix_of
    pair = pair_isotropic if isotropic else pair_full
    count_of_sums = ISOTROPIC_ROWS if isotropic else ROWS
    add, store = adder(count_of_sums, fast), column_storer(ROWS, fast)
    none, nothing = (F0,) * count_of_sums, (0.0,) * count_of_sums
    width = 8 if isotropic else 12  # whole 16-byte words, which the compiler then loads at once

    @fast_kernel
    def adaptive_rows(moved, moved_boxes, source_sigma, target, target_boxes, target_sigma, scale, rows):
        """One block for each source tile (x) and share of the target tiles (y), one thread for each source point.

        scale : what the target's precisions are multiplied with.
        rows : (shares, ROWS, source tiles x TILE) float64, overwritten.
        """
        _ = stamp
        x = cuda.shared.array((TILE, width), float32)
        near = cuda.shared.array(TILE, int32)
        t = cuda.threadIdx.x
        own = cuda.blockIdx.x
        share = cuda.blockIdx.y
        shares = cuda.gridDim.y
        count = target.shape[0]
        y, b = point_of(moved, own, t), matrix_of(moved, own, t, F1)
        total = nothing
        s = none
        pending = 0
        for first in range(share, count, TILE * shares):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t * shares
            near[t] = tile < count and is_near(False, moved_boxes, own, source_sigma, target_boxes, tile, target_sigma)
            if cuda.syncthreads_or(near[t]) == 0:
                continue
            for k in range(TILE):
                if near[k] == 0:
                    continue
                tile = first + k * shares
                for i in range(components):
                    x[t, i] = target[tile, i, t] * (scale if i >= MATRIX else F1)
                cuda.syncthreads()
                for j in range(0, TILE, 4):
                    s = add(s, pair(x, j, y, b))
                    s = add(s, pair(x, j + 1, y, b))
                    s = add(s, pair(x, j + 2, y, b))
                    s = add(s, pair(x, j + 3, y, b))
                pending += 1
                if pending == FLUSH:
                    total = add(total, s)
                    s = none
                    pending = 0
                cuda.syncthreads()
            cuda.syncthreads()
        total = add(total, s)
        store(rows[share], 0, own * TILE + t, unfolded(total) if isotropic else total)

    return adaptive_rows


adaptive_rows_isotropic = _build(True, source_stamp())
adaptive_rows_full = _build(False, source_stamp())
