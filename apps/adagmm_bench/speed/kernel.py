"""The pair kernels beside the machine's own float32 matrix product, on one thread, every pair evaluated."""

from __future__ import annotations

import numpy as np

from adagmm_bench.speed.measurement import Measurement, best_seconds
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.mixture import make_mixture
from adagmm_o3d.mixtures.normalisation import normalise
from adagmm_o3d.pairs.cpu_pairs import PairLoop

POINTS = 4000
WIDE_SIGMA = 0.3  # so wide that no tile of pairs may be left out
MATRIX = 1024  # small enough to be done between two disturbances
GOAL = 2.0  # at least half of the matrix product's rate
COLOURS_GOAL = 1.35  # what three further coordinates may cost
# Of colours that differ by so much, where two looks at a place do too [L*a*b*].
COLOURS = 10.0

# Float operations of a pair of isotropic components, read off the kernels' inner loops. Additions, multiplications,
# and maxima count one each, integer and bit operations none; what is worked out twice counts once. exp2 is 16 of them:
# clamp, round, subtract, shift, square, a polynomial of degree five, scale. An inverse root is 6: an
# estimate and a step of Newton's.
EXP2, INVERSE_ROOT = 16, 6
OPERATIONS = {
    "paper's weights": 3 + 5 + 2 + 2 * EXP2 + 2 + 2 + 11,
    # difference, variance, inverse root, precision, distance, exp2, weight, density, factors, and the sums
    "posteriors": 3 + 1 + INVERSE_ROOT + 1 + 6 + EXP2 + 3 + 1 + 3 + 10,
}


def kernel(repeats: int) -> list[Measurement]:
    rng = np.random.default_rng(0)
    source, target, _ = normalise(
        *(make_mixture(role, rng.normal(size=(POINTS, 3)), None) for role in ("source", "target"))
    )
    pairs, pose = PairLoop(source, target), np.eye(4)
    painted = PairLoop(*(cloud.coloured(COLOURS * rng.normal(size=(POINTS, 3))) for cloud in (source, target)))
    model = ColourModel(np.full(3, COLOURS), np.ones(3), np.zeros(3), lying=0.1, floor=2.0, expected=0.3)
    a = rng.normal(size=(MATRIX, MATRIX)).astype(np.float32)
    runs = {
        "product": lambda: a @ a,
        "paper's weights": lambda: pairs.sums(pose, WIDE_SIGMA, WIDE_SIGMA),
        "posteriors": lambda: pairs.posterior_sums(pose, WIDE_SIGMA, 0.1),
        "coloured": lambda: painted.posterior_sums(pose, WIDE_SIGMA, 0.1, colour=model),
    }
    seconds = best_seconds(runs, 10 * repeats)
    product_rate = 2 * MATRIX**3 / seconds["product"]
    lines = [Measurement("kernel", "float32 matrix product", product_rate / 1e9, "GFLOP/s")]
    for name, count in OPERATIONS.items():
        pair_rate = POINTS**2 / seconds[name]
        operations = pair_rate * count
        lines += [
            Measurement("kernel", f"{name}, pairs", pair_rate / 1e6, "M/s"),
            Measurement("kernel", f"{name}, {count} operations a pair", operations / 1e9, "GFLOP/s"),
            Measurement("kernel", f"matrix product / {name}", product_rate / operations, "×", cost=True, goal=GOAL),
        ]
    ratio = seconds["coloured"] / seconds["posteriors"]
    return [
        *lines,
        Measurement("kernel", "posteriors with colours / without", ratio, "×", cost=True, goal=COLOURS_GOAL),
    ]
