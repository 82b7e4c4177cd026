"""Points without a partner: what only one of two clouds has seen, and how dense it is taken to be.

A cloud is a part of a surface (in the plane, of a curve), and what the other cloud has seen beside it is more surface
of the same kind. So the density of points without a partner is that of a surface at the scale σ of the mixtures: as
thick as they are, √(4πσ) for the convolution of both, and in area a few times a sphere (in the plane a circle) of the
clouds' radius. A point is let go where the other mixture is thinner than that: near, when σ is small, and hardly at all
while it is wide.
"""

from __future__ import annotations

import math

from adagmm_o3d.kernels.update import density_without_partner

# In units of the radius to the power of the dimension, less one: so many circles, or spheres.
AREA = {2: 7.0 * 2.0 * math.pi, 3: 4.0 * 4.0 * math.pi}
# Ends with σ of their own are compared at the density that belongs to this one: what a pose leaves unexplained costs
# the same in all of them.
COMPARED_SIGMA = 0.025


def uniform_density(unmatched: float, sigma: float, dimension: int) -> float:
    """Density of the points without a partner, where they are a share `unmatched` of all, relative to that of a mixture
    at scale `sigma`, without the constant (2π)^(-D/2)."""
    return density_without_partner(world_density(dimension), sigma, unmatched)


def world_density(dimension: int) -> float:
    """The same at σ = 1 for as many points with as without a partner."""
    return (2.0 * math.pi) ** (0.5 * dimension) / (AREA[dimension] * math.sqrt(4.0 * math.pi))
