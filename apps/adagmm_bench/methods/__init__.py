"""Every method the bench compares. A new one is a function under `@method` in a module imported here, or in one that an
entry point of another package names, of the group `adagmm_bench.methods`.
"""

from adagmm_bench.methods import (  # noqa: F401  importing registers
    dense_clouds,
    fast_gicp_methods,
    kiss_matcher_methods,
    lidar_scans,
    open3d_global,
    open3d_local,
    ours,
    point_drift,
    small_gicp_methods,
    teaser_methods,
)
from adagmm_bench.methods.registry import METHODS, Method, choose_methods, method, register_others

register_others()

__all__ = ["METHODS", "Method", "choose_methods", "method"]
