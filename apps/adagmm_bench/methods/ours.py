"""Adaptive Gaussian mixtures, in the variants whose figures the reports tell apart."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods.registry import method
from adagmm_bench.problem import Cloud
from adagmm_o3d import PointRegistrationResult, TransformationEstimationForAdaptiveGMM, register_points

ARGUMENTS = {
    "adagmm": {},
    "adagmm-paper": {"estimation_method": TransformationEstimationForAdaptiveGMM(sigma_rule="nearest", start="init")},
    "adagmm-paper-literal": {
        "estimation_method": TransformationEstimationForAdaptiveGMM(sigma_rule="figure2", start="init")
    },
    "adagmm-global": {"init": "global"},
}


def register(name: str, source: Cloud, target: Cloud) -> PointRegistrationResult:
    """One of ARGUMENTS on two clouds, with its own record of the way."""
    return register_points(
        source.points, target.points, source.covariances, target.covariances, device="cpu", **ARGUMENTS[name]
    )


@method("adagmm", library="adagmm_o3d", ours=True)
def default(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with its default options."""
    return register("adagmm", source, target).transformation


@method("adagmm-paper", library="adagmm_o3d", ours=True)
def paper(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with the rule that gives the paper's accuracy: sigma from squared nearest distances, both clouds."""
    return register("adagmm-paper", source, target).transformation


@method("adagmm-paper-literal", library="adagmm_o3d", ours=True)
def paper_literal(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with the letter of the paper's Figure 2: sigma the mean nearest distance, on the source alone."""
    return register("adagmm-paper-literal", source, target).transformation


@method("adagmm-global", library="adagmm_o3d", ours=True, anywhere=True)
def everywhere(source: Cloud, target: Cloud) -> np.ndarray:
    """This package with init="global": from anywhere, then its default options."""
    return register("adagmm-global", source, target).transformation
