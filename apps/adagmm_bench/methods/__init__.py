"""Every method the bench compares. A new one is a function under `@method` in a module imported here."""

from adagmm_bench.methods import (  # noqa: F401  importing registers
    dense_clouds,
    fast_gicp_methods,
    kiss_matcher_methods,
    open3d_global,
    open3d_local,
    ours,
    point_drift,
    small_gicp_methods,
    teaser_methods,
)
from adagmm_bench.methods.registry import METHODS, Method, choose_methods, method

__all__ = ["METHODS", "Method", "choose_methods", "method"]
