"""Adaptive Gaussian mixtures, in the variants whose figures the reports tell apart."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud
from adagmm_o3d import TransformationEstimationForAdaptiveGMM, register_points


def _register(source: Cloud, target: Cloud, **arguments) -> np.ndarray:
    return register_points(
        source.points, target.points, source.covariances, target.covariances, device="cpu", **arguments
    ).transformation


@method("adagmm", library="adagmm_o3d", ours=True)
def default(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with its default options."""
    return _register(source, target)


@method("adagmm-paper", library="adagmm_o3d", ours=True)
def paper(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with the rule that gives the paper's accuracy: sigma from the squared nearest distances, on both
    clouds.
    """
    return _register(
        source, target, estimation_method=TransformationEstimationForAdaptiveGMM(sigma_rule="nearest", start="init")
    )


@method("adagmm-paper-literal", library="adagmm_o3d", ours=True)
def paper_literal(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with the letter of the paper's Figure 2: sigma the mean nearest distance, on the source alone."""
    return _register(
        source, target, estimation_method=TransformationEstimationForAdaptiveGMM(sigma_rule="figure2", start="init")
    )


@method("adagmm-global", library="adagmm_o3d", ours=True, anywhere=True)
def everywhere(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with init="global": from anywhere, then its default options."""
    return _register(source, target, init="global")
