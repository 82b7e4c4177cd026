"""What the colours say of the partners that each point of the source has at the end."""

from __future__ import annotations

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.unmatched import uniform_density
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.spacing import spacing_of_whole
from adagmm_o3d.pairs.device import make_pair_loop
from adagmm_o3d.sampling import quantile, some_of
from adagmm_o3d.trust.pose_covariance import Fit

# The share of points without a partner that is taken for granted, and the probability from which a point has one.
UNMATCHED, HAS_PARTNER = 0.1, 0.5
# How many points are asked how wide they are.
WIDTHS = 1000
# Probabilities are told apart to this much.
LEAST = 1e-12


def color_support(source: Mixture, target: Mixture, fit: Fit, device: str) -> Array:
    """(size of the input,) by how much colours change the log odds of each source point to have a partner [nats].

    NaN where it has none by the geometry. The mixtures are taken to be no narrower than the target's spacing: a point
    between its samples would seem to have no partner.
    """
    widest = float(quantile(target.take(some_of(np.arange(len(target)), WIDTHS)).largest_variances, 0.5))
    sigma = max(fit.sigma, spacing_of_whole(target) ** 2 / widest)
    uniform = uniform_density(UNMATCHED, sigma, source.dimension)
    pairs = make_pair_loop(source, target, device)
    plain, coloured = (
        np.clip(pairs.posterior_sums(fit.pose, sigma, uniform, 0.0, colour).row_weights, LEAST, 1.0 - LEAST)
        for colour in (None, fit.colour)
    )
    support = np.full(len(source.kept), np.nan)
    change = np.log(coloured / (1.0 - coloured)) - np.log(plain / (1.0 - plain))
    support[source.kept] = np.where(plain >= HAS_PARTNER, change, np.nan)
    return support
