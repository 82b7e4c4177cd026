"""fast_gicp, whose Python module pygicp has to be built from its sources (it needs PCL)."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods.lifting import THIN_HEIGHT, lift, lower
from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud

DISTANCES = (1.0, 0.5, 0.25, 0.12, 0.06)  # radii


@method("fast-gicp", library="pygicp")
def fast_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """fast_gicp generalized ICP, covariances from 20 neighbours, within 1.0, 0.5, 0.25, 0.12, then 0.06 radii, one
    thread.
    """
    import pygicp

    gicp = pygicp.FastGICP()
    gicp.set_input_target(lift(target, THIN_HEIGHT).points)
    gicp.set_input_source(lift(source, THIN_HEIGHT).points)
    gicp.set_correspondence_randomness(20)
    gicp.set_num_threads(1)
    T = np.eye(4)
    for distance in DISTANCES:
        gicp.set_max_correspondence_distance(distance)
        T = gicp.align(initial_guess=T.astype(np.float32))
    return lower(np.asarray(T, dtype=float), source.points.shape[1])
