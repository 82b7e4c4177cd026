"""Compile the CPU kernels ahead: `python -m adagmm_o3d.warm_up`, when an image is built or before a first registration.

What is compiled stays in Numba's cache: beside the installed package where that can be written, else in the user's
cache folder, or where NUMBA_CACHE_DIR says. Kernels beside the package serve everybody who uses it from then on, also
where nothing can be written. They are for the kind of processor that compiled them; another one compiles its own.
"""

from typing import get_args

import numpy as np

from adagmm_o3d.array_registration import register_points
from adagmm_o3d.grouping import DENSE_FROM
from adagmm_o3d.options import SigmaRuleName, TransformationEstimationForAdaptiveGMM
from adagmm_o3d.uncertainty.surface import estimate_surface_covariances

# A cloud whose points all meet, and one of which only near ones do.
FEW, MANY = 60, 1500


def warm_up(*, paper_rules: bool = True) -> None:
    """Register small clouds in each way that has kernels of its own; half a minute where nothing is compiled yet.

    paper_rules : those of the paper's own `sigma_rule`s as well.
    """
    points = np.random.default_rng(0).normal(size=(MANY, 3))
    few = points[:FEW]
    colors = 0.5 + 0.5 * np.tanh(points)
    for both in (None, colors):
        result = register_points(points + 0.1, points, device="cpu", source_colors=both, target_colors=both)
        result.find_partners()
        result.assess()
        result.weigh()
    # A surface whose parts share a half only, which features have to tell; and what no feature tells, with viewpoints.
    sphere = points / np.linalg.norm(points, axis=1, keepdims=True) * (1.0, 0.7, 0.4)
    left, right = sphere[sphere[:, 0] < 0.3], sphere[sphere[:, 0] > -0.3]
    covariances = [np.tile(np.diag([1.0, 1.0, 0.5]), (len(part), 1, 1)) for part in (left, right)]
    register_points(left, right[:, ::-1].copy(), *covariances, device="cpu")
    # A cloud so dense that its points are put into cells.
    estimate_surface_covariances(np.resize(points, (DENSE_FROM, 3)))
    far = np.full(3, 10.0)
    other = 0.5 * right[:, ::-1]
    register_points(left, other, *covariances, device="cpu", source_viewpoint=far, target_viewpoint=far)
    register_points(few, few, init="global", device="cpu")
    for rule in get_args(SigmaRuleName) if paper_rules else ():
        options = TransformationEstimationForAdaptiveGMM(sigma_rule=rule)
        register_points(few, few, estimation_method=options, device="cpu")


if __name__ == "__main__":
    warm_up()
