"""A branch-free 2**x for float32 that the compiler turns into vector instructions; libm's exp stays scalar in Numba."""

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

# The least exponent. What is so small adds nothing to any sum; but times shares of a million points it would be less
# than 2**-126, and such numbers cost a processor a hundred cycles each: on thin covariances, whose pairs are mostly far
# apart across the surface, that made a pass up to three times as long.
LOWEST = np.float32(-64.0)
# A whole number plus this has its value in the sum's last bits, with 127, the bias of float32's exponents, added.
SHIFT = np.float32(1.5 * 2**23 + 127)
# Of all polynomials of degree five with C0 = 1 this one has the least largest relative error on [-1/2, 1/2]: 9e-8. The
# Taylor polynomial of degree six has a larger one.
C0, C1, C2, C3, C4, C5 = map(np.float32, (1.0, 0.693147, 0.24022242, 0.055507336, 0.009671513, 0.0013264727))
MANTISSA_BITS = np.int32(23)


@intrinsic
def _as_int32(_context, x):
    def codegen(_, builder, _signature, args):
        return builder.bitcast(args[0], ir.IntType(32))

    return types.int32(types.float32), codegen


@intrinsic
def _as_float32(_context, bits):
    def codegen(_, builder, _signature, args):
        return builder.bitcast(args[0], ir.FloatType())

    return types.float32(types.int32), codegen


@intrinsic
def _nearest_whole(_context, x):
    def codegen(_, builder, _signature, args):
        return builder.call(builder.module.declare_intrinsic("llvm.nearbyint", [ir.FloatType()]), args)

    return types.float32(types.float32), codegen


# The compiler may contract a product and a sum into one operation. It may not reorder sums: the rounding would suffer.
@njit(fastmath={"contract"}, error_model="numpy")
def exp2_float32(x):
    """2**x for float32 x <= 0, relative error below 3e-7; below -64 it stays at 2**-64."""
    x = x if x > LOWEST else LOWEST
    # Adding SHIFT and subtracting it would round as well, but r would have to wait for both.
    rounded = _nearest_whole(x)
    r = x - rounded
    # The last bits of the sum are the biased exponent; moved to the exponent's place they make the number 2**rounded.
    whole = _as_float32(np.int32(_as_int32(rounded + SHIFT) << MANTISSA_BITS))
    # The terms are added in pairs: fewer operations wait for one another than by Horner's rule.
    square = r * r
    fraction = ((C5 * r + C4) * square + (C3 * r + C2)) * square + (C1 * r + C0)
    return fraction * whole
