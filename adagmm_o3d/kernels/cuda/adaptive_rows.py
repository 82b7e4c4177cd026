"""The paper's E-step on the GPU: the sums of every source point over the target, as in `kernels.cpu.adaptive_rows`."""

from numba import float32, int32

from adagmm_o3d.kernels.cuda.front_end import F0, F1, TILE, cuda, fast, fast_kernel, formulas, source_stamp
from adagmm_o3d.kernels.cuda.tiles import is_near, isotropic_matrix_of, packed_matrix_of, point_of
from adagmm_o3d.kernels.layout import FACTOR, ISOTROPIC_FACTOR, MATRIX, SHARE, X

adaptive_full, adaptive_isotropic, dot = formulas.adaptive_full, formulas.adaptive_isotropic, formulas.dot

# Sums of a source point: layout.WEIGHT to TORQUE.
ROWS = 14
# Tiles summed in float32 before float64 takes over.
FLUSH = 4
NONE = (F0,) * ROWS
NOTHING = (0.0,) * ROWS


@fast
def pair_anisotropic(x, j, y, b, s):
    """The sums `s` of source point y (3), its packed precision b (6), and target point j of the tile `x` added."""
    dx = y[0] - x[j, X]
    dy = y[1] - x[j, X + 1]
    dz = y[2] - x[j, X + 2]
    a0, a1, a2 = x[j, MATRIX], x[j, MATRIX + 1], x[j, MATRIX + 2]
    a3, a4, a5 = x[j, MATRIX + 3], x[j, MATRIX + 4], x[j, MATRIX + 5]
    c, q, ux, uy, uz, tx, ty, tz = adaptive_full(
        x[j, SHARE], dx, dy, dz, a0, a1, a2, a3, a4, a5, b[0], b[1], b[2], b[3], b[4], b[5]
    )
    return (
        s[0] + c,
        s[1] + c * q,
        s[2] + c * a0,
        s[3] + c * a1,
        s[4] + c * a2,
        s[5] + c * a3,
        s[6] + c * a4,
        s[7] + c * a5,
        s[8] + c * ux,
        s[9] + c * uy,
        s[10] + c * uz,
        s[11] + c * tx,
        s[12] + c * ty,
        s[13] + c * tz,
    )


@fast
def pair_isotropic(x, j, y, b, s):
    """The same where every precision is a multiple of the identity: nothing turns, three directions share one sum."""
    dx = y[0] - x[j, X]
    dy = y[1] - x[j, X + 1]
    dz = y[2] - x[j, X + 2]
    a = x[j, MATRIX]
    d2 = dot(dx, dy, dz, dx, dy, dz)
    c = adaptive_isotropic(x[j, SHARE], d2, a, b)
    k = c * (a + b)
    p = s[2] + c * a
    return (s[0] + c, s[1] + k * d2, p, F0, F0, p, F0, p, s[8] + k * dx, s[9] + k * dy, s[10] + k * dz, F0, F0, F0)


@fast
def added(total, s):
    """The float64 sums `total` with the float32 sums `s` added."""
    return (
        total[0] + s[0],
        total[1] + s[1],
        total[2] + s[2],
        total[3] + s[3],
        total[4] + s[4],
        total[5] + s[5],
        total[6] + s[6],
        total[7] + s[7],
        total[8] + s[8],
        total[9] + s[9],
        total[10] + s[10],
        total[11] + s[11],
        total[12] + s[12],
        total[13] + s[13],
    )


def _build(isotropic, stamp):
    """The kernel for one kind of matrices; `stamp` keeps its cache fresh."""
    components = ISOTROPIC_FACTOR if isotropic else FACTOR  # a tile ends where a factor would be
    matrix_of = isotropic_matrix_of if isotropic else packed_matrix_of
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
        total = NOTHING
        s = NONE
        pending = 0
        for first in range(share, count, TILE * shares):
            # Every thread tests one tile, then all threads take those in reach, one after another.
            tile = first + t * shares
            found = 0
            if tile < count and is_near(False, moved_boxes, own, source_sigma, target_boxes, tile, target_sigma):
                found = 1
            near[t] = found
            if cuda.syncthreads_or(found) == 0:
                continue
            for k in range(TILE):
                if near[k] == 0:
                    continue
                tile = first + k * shares
                for i in range(components):
                    x[t, i] = target[tile, i, t] * (scale if i >= MATRIX else F1)
                cuda.syncthreads()
                for j in range(0, TILE, 4):
                    if isotropic:
                        s = pair_isotropic(x, j, y, b, s)
                        s = pair_isotropic(x, j + 1, y, b, s)
                        s = pair_isotropic(x, j + 2, y, b, s)
                        s = pair_isotropic(x, j + 3, y, b, s)
                    else:
                        s = pair_anisotropic(x, j, y, b, s)
                        s = pair_anisotropic(x, j + 1, y, b, s)
                        s = pair_anisotropic(x, j + 2, y, b, s)
                        s = pair_anisotropic(x, j + 3, y, b, s)
                pending += 1
                if pending == FLUSH:
                    total = added(total, s)
                    s = NONE
                    pending = 0
                cuda.syncthreads()
            cuda.syncthreads()
        total = added(total, s)
        m = own * TILE + t
        rows[share, 0, m] = total[0]
        rows[share, 1, m] = total[1]
        rows[share, 2, m] = total[2]
        rows[share, 3, m] = total[3]
        rows[share, 4, m] = total[4]
        rows[share, 5, m] = total[5]
        rows[share, 6, m] = total[6]
        rows[share, 7, m] = total[7]
        rows[share, 8, m] = total[8]
        rows[share, 9, m] = total[9]
        rows[share, 10, m] = total[10]
        rows[share, 11, m] = total[11]
        rows[share, 12, m] = total[12]
        rows[share, 13, m] = total[13]

    return adaptive_rows


adaptive_rows_isotropic = _build(True, source_stamp())
adaptive_rows_anisotropic = _build(False, source_stamp())
