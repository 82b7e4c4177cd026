"""Every CUDA kernel compiles for every generation of GPU, and keeps to its registers; no GPU needed."""

import re

import cuda_compiling
import numpy as np
import pytest

from adagmm_o3d.kernels.cuda.availability import missing_front_end, simulated

if (missing := missing_front_end()) is not None or simulated():
    pytest.skip(missing or "the simulator compiles nothing", allow_module_level=True)

from numba import boolean, cuda, float32, float64, int32, types, uint8, uint32

from adagmm_o3d.kernels.cuda import (
    adaptive_rows,
    convolved_columns,
    convolved_rows,
    moving,
    nearest,
    reductions,
    scores,
)
from adagmm_o3d.kernels.cuda.clouds import inspecting, packing, summing, surface

pytestmark = pytest.mark.slow

CAPABILITIES = [(7, 5), (8, 0), (9, 0)]
# Nothing may be left to local memory, be it an array or a register that did not fit.
MOST_LOCAL_BYTES = 0
# 64 threads of 128 registers: 8 blocks, 512 threads on a multiprocessor, enough for two pairs in flight in each.
MOST_REGISTERS = 128
# What every multiprocessor has for a block without asking for more.
MOST_SHARED_BYTES = 48 * 1024


def array(dtype, dimensions):
    return types.Array(dtype, dimensions, "C")


POSE = types.UniTuple(float32, 12)
POINTS, BOXES, FLAT = array(float32, 3), array(float32, 2), array(float32, 1)
SUMS, TABLE, VECTOR = array(float64, 3), array(float64, 2), array(float64, 1)
MOVE = (POSE, float32, boolean, POINTS, BOXES, POINTS, BOXES)
ADAPTIVE = (POINTS, BOXES, float32, POINTS, BOXES, float32, float32, SUMS)
CONVOLVED = (POINTS, BOXES, POINTS, BOXES, float32, boolean, BOXES, float32, float32, POINTS, POINTS, float32, SUMS)
COLUMNS = (POINTS, BOXES, float32, boolean, POINTS, BOXES, POINTS, POINTS, float32, TABLE)
NARROW, WIDE = (BOXES, POINTS, TABLE, array(uint8, 1)), (TABLE, SUMS, TABLE, array(uint8, 1))
CENTRE, INDEX = types.UniTuple(float64, 3), array(int32, 1)
FRAME = (CENTRE, float64, float64, float64, float64)
PACK = (TABLE, INDEX, *FRAME, BOXES, BOXES, POINTS, BOXES)
SCORES = (BOXES, POINTS, BOXES, float32, float32, BOXES, BOXES, float32, POINTS, POINTS, float32, TABLE)
KERNELS = [
    (moving.move_isotropic, MOVE),
    (moving.move_full, MOVE),
    (adaptive_rows.adaptive_rows_isotropic, ADAPTIVE),
    (adaptive_rows.adaptive_rows_full, ADAPTIVE),
    (convolved_rows.convolved_rows_isotropic, CONVOLVED),
    (convolved_rows.convolved_rows_full, CONVOLVED),
    (convolved_columns.convolved_columns_isotropic, COLUMNS),
    (convolved_columns.convolved_columns_full, COLUMNS),
    (convolved_rows.coloured_rows_isotropic, CONVOLVED),
    (convolved_rows.coloured_rows_full, CONVOLVED),
    (convolved_columns.coloured_columns_isotropic, COLUMNS),
    (convolved_columns.coloured_columns_full, COLUMNS),
    (nearest.nearest_sq, (POINTS, BOXES, POINTS, BOXES, BOXES)),
    (reductions.reduce_adaptive_isotropic, (POINTS, SUMS, TABLE, VECTOR, TABLE)),
    (reductions.reduce_adaptive_full, (POINTS, SUMS, TABLE, VECTOR, TABLE)),
    (reductions.reduce_convolved, (POINTS, SUMS, TABLE, float64, float64, VECTOR, TABLE)),
    (reductions.reduce_columns, (TABLE, float64, VECTOR, BOXES)),
    (reductions.reduce_nearest, (BOXES, FLAT)),
    (reductions.total, (TABLE, VECTOR)),
    (inspecting.inspect_given, NARROW),
    (inspecting.inspect_given, WIDE),
    (inspecting.inspect_bare, (BOXES, BOXES, TABLE, array(uint8, 1))),
    (inspecting.inspect_bare, (TABLE, TABLE, TABLE, array(uint8, 1))),
    (inspecting.fill_empty, (TABLE, float64)),
    (summing.bounds, (TABLE, TABLE)),
    (summing.moments, (TABLE, VECTOR, CENTRE, CENTRE, float64, TABLE)),
    (packing.morton_codes, (TABLE, CENTRE, float64, CENTRE, float64, array(uint32, 1))),
    (packing.gather, (TABLE, INDEX, TABLE)),
    (packing.pack_precisions_isotropic, PACK),
    (packing.pack_precisions, PACK),
    (packing.pack_covariances_isotropic, PACK),
    (packing.pack_covariances, PACK),
    (scores.score_sums_of_source_isotropic, SCORES),
    (scores.score_sums_of_source, SCORES),
    (scores.score_sums_of_target_isotropic, SCORES),
    (scores.score_sums_of_target, SCORES),
    (scores.coloured_sums_of_source_isotropic, SCORES),
    (scores.coloured_sums_of_source, SCORES),
    (scores.coloured_sums_of_target_isotropic, SCORES),
    (scores.coloured_sums_of_target, SCORES),
    (surface.point_boxes, (TABLE, TABLE)),
    (surface.surface_covariances, (TABLE, TABLE, INDEX, TABLE)),
]
NAMES = ["move isotropic", "move", "adaptive isotropic", "adaptive", "convolved isotropic", "convolved"]
NAMES += ["columns isotropic", "columns", "coloured rows isotropic", "coloured rows"]
NAMES += ["coloured columns isotropic", "coloured columns"]
NAMES += ["nearest", "reduce adaptive isotropic", "reduce adaptive"]
NAMES += ["reduce convolved", "reduce columns", "reduce nearest", "total"]
NAMES += ["inspect float32", "inspect float64", "inspect bare float32", "inspect bare float64", "fill empty"]
NAMES += ["bounds", "moments"]
NAMES += ["codes", "gather", "pack precisions isotropic", "pack precisions", "pack covariances isotropic"]
NAMES += [
    "pack covariances",
    "scores of source isotropic",
    "scores of source",
    "scores of target isotropic",
    "scores of target",
    "coloured scores of source isotropic",
    "coloured scores of source",
    "coloured scores of target isotropic",
    "coloured scores of target",
    "point boxes",
    "surface",
]


CONVOLVED_NAMES = ["convolved isotropic", "convolved", "columns isotropic", "columns"]


@pytest.mark.parametrize("capability", CAPABILITIES, ids=lambda c: "sm_{}{}".format(*c))
@pytest.mark.parametrize(("kernel", "signature"), KERNELS, ids=NAMES)
def test_kernel_compiles_and_keeps_to_its_registers(kernel, signature, capability, tmp_path):
    ptx = cuda_compiling.compile_to_ptx(kernel, signature, capability)
    assert ".target sm_{}{}".format(*capability) in ptx
    assert ".entry" in ptx
    # The order of a sum may not depend on who comes first.
    assert not re.search(r"^\s*(@!?%p\d+\s+)?(atom|red)\.", ptx, re.MULTILINE)
    if cuda_compiling.find_ptxas() is None:
        pytest.skip("compiled to PTX, but no ptxas to assemble it: no CUDA toolkit and no nvidia-cuda-nvcc")
    resources = cuda_compiling.assemble(ptx, capability, tmp_path)
    assert resources.spilled_bytes == 0
    assert resources.local_bytes <= MOST_LOCAL_BYTES
    assert resources.registers <= MOST_REGISTERS
    assert resources.shared_bytes <= MOST_SHARED_BYTES


def test_every_kernel_of_the_package_is_in_the_list():
    modules = (adaptive_rows, convolved_columns, convolved_rows, moving, nearest, reductions)
    modules += (inspecting, packing, scores, summing, surface)
    dispatcher = type(reductions.total)
    launched = {
        id(value)
        for module in modules
        for value in vars(module).values()
        if isinstance(value, dispatcher) and not value.targetoptions.get("device")
    }
    assert launched == {id(kernel) for kernel, _ in KERNELS}


@pytest.mark.parametrize("name", ["adaptive isotropic", "adaptive", *CONVOLVED_NAMES])
def test_pair_loops_use_the_hardware_functions_and_no_float64(name):
    kernel, signature = KERNELS[NAMES.index(name)]
    ptx = cuda_compiling.compile_to_ptx(kernel, signature, (8, 0))
    assert "ex2.approx.ftz.f32" in ptx
    assert ("rsqrt.approx.ftz.f32" in ptx) is (name in CONVOLVED_NAMES)
    assert not re.search(r"\s(sqrt|rcp)\.", ptx)
    # float64 takes over at the end of a run of tiles, and for the sums themselves.
    assert "cvt.rn.f32.f64" not in ptx and "mul.f64" not in ptx and "mul.rn.f64" not in ptx


@pytest.mark.skipif(cuda_compiling.find_ptxas() is None, reason="no ptxas: no CUDA toolkit and no nvidia-cuda-nvcc")
def test_local_memory_is_noticed(tmp_path):
    def kernel(order, out):
        slots = cuda.local.array(40, float32)
        for i in range(40):
            slots[order[i]] = out[i]
        for i in range(40):
            out[i] = slots[39 - i] + slots[order[i]]

    ptx = cuda_compiling.compile_to_ptx(cuda.jit(kernel), (array(types.int64, 1), FLAT), (8, 0))
    assert cuda_compiling.assemble(ptx, (8, 0), tmp_path).local_bytes >= 40 * np.dtype(np.float32).itemsize
