"""The formulas of the pair loop, written once and compiled for every device.

`build` compiles them with the decorator of one device: `numba.njit` on the CPU, `cuda.jit(device=True)` on a GPU.
Each argument is one number, which both compilers keep in a register: that is why some take many. They hold no float
literal, so the arithmetic has the type of the arguments. Symmetric 3x3 matrices are packed as (xx, xy, xz, yy, yz, zz).
2D is the plane z = 0: the entries with a z are zero and so are all sums over them.
"""

import math
from types import SimpleNamespace

# exp(-q/2) = 2**-(LOG2_SCALE q): the kernels know only powers of two.
LOG2_SCALE = 0.5 / math.log(2.0)


def build(jit, inverse_root, power_of_two):
    """The formulas, compiled by `jit`, as a namespace; `inverse_root` and `power_of_two` are the device's 1/√x and 2ˣ,
    compiled for it."""

    @jit
    def symmetric_product(p0, p1, p2, p3, p4, p5, x, y, z):
        """P · (x, y, z) for a packed symmetric P."""
        return p0 * x + p1 * y + p2 * z, p1 * x + p3 * y + p4 * z, p2 * x + p4 * y + p5 * z

    @jit
    def dot(ax, ay, az, bx, by, bz):
        return ax * bx + ay * by + az * bz

    @jit
    def cross(ax, ay, az, bx, by, bz):
        return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx

    @jit
    def rotate_point(r, x, y, z):
        """R · (x, y, z) + t for `r` = (12,), the rows of [R | t]."""
        return (
            r[0] * x + r[1] * y + r[2] * z + r[3],
            r[4] * x + r[5] * y + r[6] * z + r[7],
            r[8] * x + r[9] * y + r[10] * z + r[11],
        )

    @jit
    def rotate_symmetric(r, p0, p1, p2, p3, p4, p5):
        """R · P · Rᵀ for a packed symmetric P."""
        a0, a1, a2 = symmetric_product(p0, p1, p2, p3, p4, p5, r[0], r[1], r[2])
        b0, b1, b2 = symmetric_product(p0, p1, p2, p3, p4, p5, r[4], r[5], r[6])
        c0, c1, c2 = symmetric_product(p0, p1, p2, p3, p4, p5, r[8], r[9], r[10])
        return (
            dot(r[0], r[1], r[2], a0, a1, a2),
            dot(r[0], r[1], r[2], b0, b1, b2),
            dot(r[0], r[1], r[2], c0, c1, c2),
            dot(r[4], r[5], r[6], b0, b1, b2),
            dot(r[4], r[5], r[6], c0, c1, c2),
            dot(r[8], r[9], r[10], c0, c1, c2),
        )

    @jit
    def adjugate(p0, p1, p2, p3, p4, p5):
        """The packed adjugate of a packed symmetric P; divided by |P| it is the inverse, its first row · P's is |P|."""
        return (
            p3 * p5 - p4 * p4,
            p2 * p4 - p1 * p5,
            p1 * p4 - p2 * p3,
            p0 * p5 - p2 * p2,
            p1 * p2 - p0 * p4,
            p0 * p3 - p1 * p1,
        )

    @jit
    def capped_distance(ax, ay, az, bx, by, bz, cap):
        """‖a - b‖², or `cap` where it is more: how much less probable two colours make it that points are the same."""
        dx, dy, dz = ax - bx, ay - by, az - bz
        d = dx * dx + dy * dy + dz * dz
        return d if d < cap else cap

    @jit
    def adaptive_full(amplitude, d0, d1, d2, a0, a1, a2, a3, a4, a5, b0, b1, b2, b3, b4, b5):
        """A pair of the paper's (Eq. 5): offset d, target precision A and source precision B, both packed, over σ.

        Its weight amplitude · (2**-dᵀA d + 2**-dᵀB d), dᵀ(A + B)d, (A + B)d, and d x (B d): what B's turning adds.
        """
        u0, u1, u2 = symmetric_product(a0, a1, a2, a3, a4, a5, d0, d1, d2)
        v0, v1, v2 = symmetric_product(b0, b1, b2, b3, b4, b5, d0, d1, d2)
        qa = dot(d0, d1, d2, u0, u1, u2)
        qb = dot(d0, d1, d2, v0, v1, v2)
        weight = amplitude * (power_of_two(-qa) + power_of_two(-qb))
        t0, t1, t2 = cross(d0, d1, d2, v0, v1, v2)
        return weight, qa + qb, u0 + v0, u1 + v1, u2 + v2, t0, t1, t2

    @jit
    def adaptive_isotropic(amplitude, square, a, b):
        """The weight of such a pair, `square` = ‖d‖², where A and B are a and b times the identity."""
        return amplitude * (power_of_two(-a * square) + power_of_two(-b * square))

    @jit
    def convolved_full(share, d0, d1, d2, s0, s1, s2, s3, s4, s5):
        """A pair of convolved Gaussians, whose offset is d and whose packed covariances add up to S.

        The height share · |S|^(-1/2), 1/|S|, the squared Mahalanobis distance q, and, times |S|, S⁻¹ d and S⁻¹: the
        pair weighs height · exp(-q/2), see `density_of`.
        """
        c0, c1, c2, c3, c4, c5 = adjugate(s0, s1, s2, s3, s4, s5)
        root = inverse_root(dot(s0, s1, s2, c0, c1, c2))
        inverse = root * root
        v0, v1, v2 = symmetric_product(c0, c1, c2, c3, c4, c5, d0, d1, d2)
        q = dot(d0, d1, d2, v0, v1, v2) * inverse
        return share * root, inverse, q, v0, v1, v2, c0, c1, c2, c3, c4, c5

    @jit
    def convolved_planar(share, d0, d1, s0, s1, s3):
        """The same in the plane: height, 1/|S|, q, and S⁻¹ d times |S|; S⁻¹ times |S| is (s3, -s1, s0)."""
        root = inverse_root(s0 * s3 - s1 * s1)
        inverse = root * root
        v0 = s3 * d0 - s1 * d1
        v1 = s0 * d1 - s1 * d0
        return share * root, inverse, (d0 * v0 + d1 * v1) * inverse, v0, v1

    @jit
    def convolved_isotropic(share, d0, d1, d2, s, planar):
        """The same where S is s times the identity: height, 1/s, q."""
        root = inverse_root(s)
        precision = root * root
        q = precision * dot(d0, d1, d2, d0, d1, d2)
        # |S|^(-1/2): the precision to the power D / 2.
        height = share * precision
        return height if planar else height * root, precision, q

    @jit
    def density_of(height, exponent):
        """What such a pair adds to the density at either of its points, and so its weight: height · 2**-exponent. The
        exponent is q and how unlike the colours are, if these count."""
        return height * power_of_two(-exponent)

    @jit
    def normal_equations(y0, y1, y2, p0, p1, p2, p3, p4, p5, u0, u1, u2, t0, t1, t2):
        """What a point y with precision P, pull u and torque t adds to the 6x6 system of a left perturbation (ω, v).

        The upper triangle of [y]ₓ P [y]ₓᵀ, [y]ₓ P and P, row by row, then the gradient: layout.HESSIAN to TOTAL_WEIGHT.
        """
        # [y]x P; the columns of P are (p0 p1 p2), (p1 p3 p4), (p2 p4 p5).
        k00, k10, k20 = cross(y0, y1, y2, p0, p1, p2)
        k01, k11, k21 = cross(y0, y1, y2, p1, p3, p4)
        k02, k12, k22 = cross(y0, y1, y2, p2, p4, p5)
        g0, g1, g2 = cross(y0, y1, y2, u0, u1, u2)
        return (
            k02 * y1 - k01 * y2,
            k00 * y2 - k02 * y0,
            k01 * y0 - k00 * y1,
            k00,
            k01,
            k02,
            k10 * y2 - k12 * y0,
            k11 * y0 - k10 * y1,
            k10,
            k11,
            k12,
            k21 * y0 - k20 * y1,
            k20,
            k21,
            k22,
            p0,
            p1,
            p2,
            p3,
            p4,
            p5,
            g0 - t0,
            g1 - t1,
            g2 - t2,
            u0,
            u1,
            u2,
        )

    return SimpleNamespace(
        adaptive_full=adaptive_full,
        adaptive_isotropic=adaptive_isotropic,
        adjugate=adjugate,
        convolved_full=convolved_full,
        convolved_planar=convolved_planar,
        convolved_isotropic=convolved_isotropic,
        capped_distance=capped_distance,
        density_of=density_of,
        normal_equations=normal_equations,
        symmetric_product=symmetric_product,
        dot=dot,
        cross=cross,
        rotate_point=rotate_point,
        rotate_symmetric=rotate_symmetric,
    )
