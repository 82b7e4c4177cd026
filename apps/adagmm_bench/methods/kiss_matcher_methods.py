"""KISS-Matcher, which needs no start, alone and refined."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods.open3d_global import refine
from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud
from adagmm_o3d.errors import InputError

VOXEL = 0.05  # radii


def _match(source: Cloud, target: Cloud) -> np.ndarray:
    import kiss_matcher

    matcher = kiss_matcher.KISSMatcher(kiss_matcher.KISSMatcherConfig(voxel_size=VOXEL))
    found = matcher.estimate(source.points.astype(np.float32), target.points.astype(np.float32))
    if not found.valid:
        raise InputError("kiss-matcher found no consistent set of matches")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = found.rotation, np.ravel(found.translation)
    return T


@method("kiss-matcher", library="kiss_matcher", dimensions=(3,), anywhere=True)
def kiss(source: Cloud, target: Cloud) -> np.ndarray:
    """KISS-Matcher, voxel 0.05 radii, its other settings as they come."""
    return _match(source, target)


@method("kiss-matcher-gicp", library="kiss_matcher", dimensions=(3,), anywhere=True)
def kiss_gicp(source: Cloud, target: Cloud) -> np.ndarray:
    """KISS-Matcher as above, then Open3D generalized ICP within 0.25 and 0.12 radii."""
    return refine(source, target, _match(source, target))
