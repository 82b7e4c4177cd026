"""The source as it lies at a pose, its matrices turned and scaled, with the boxes of its tiles."""

from numba import float32

from adagmm_o3d.kernels.cuda.front_end import F0, F1, TILE, cuda, exact, exact_formulas, kernel, source_stamp
from adagmm_o3d.kernels.cuda.tiles import BOX_VARIANCE, extreme, isotropic_matrix_of, packed_matrix_of, point_of
from adagmm_o3d.kernels.cuda.tuples import column_storer
from adagmm_o3d.kernels.layout import MATRIX, SHARE, X

rotate_point, rotate_symmetric = exact_formulas.rotate_point, exact_formulas.rotate_symmetric
store_packed = column_storer(6, exact)


def _build(isotropic, stamp):
    """The kernel for one kind of matrices; `stamp` keeps its cache fresh."""

    @kernel
    def move_source(pose, scale, planar, source, source_boxes, moved, moved_boxes):
        """One block for each tile. `planar`: the matrices are covariances in the plane, to which zz = 1 is added."""
        _ = stamp
        corners = cuda.shared.array((TILE, 6), float32)
        tile = cuda.blockIdx.x
        t = cuda.threadIdx.x
        p = point_of(source, tile, t)
        x, y, z = rotate_point(pose, p.x, p.y, p.z)
        moved[tile, X, t] = x
        moved[tile, X + 1, t] = y
        moved[tile, X + 2, t] = z
        moved[tile, SHARE, t] = source[tile, SHARE, t]
        if isotropic:
            moved[tile, MATRIX, t] = isotropic_matrix_of(source, tile, t, scale)
        else:
            b = packed_matrix_of(source, tile, t, scale)
            p0, p1, p2, p3, p4, p5 = rotate_symmetric(pose, b.xx, b.xy, b.xz, b.yy, b.yz, b.zz)
            store_packed(moved[tile], MATRIX, t, (p0, p1, p2, p3, p4, p5 + (F1 if planar else F0)))
        corners[t, 0] = x
        corners[t, 1] = y
        corners[t, 2] = z
        corners[t, 3] = x
        corners[t, 4] = y
        corners[t, 5] = z
        cuda.syncthreads()
        if t < 6:
            moved_boxes[tile, t] = extreme(corners, t)
        elif t < 8:
            moved_boxes[tile, t] = source_boxes[tile, BOX_VARIANCE + t - 6]

    return move_source


move_isotropic = _build(True, source_stamp())
move_full = _build(False, source_stamp())
