"""Adaptive Gaussian mixtures: the variants that the reports tell apart, and the default with one choice undone."""

from __future__ import annotations

import numpy as np

from adagmm_bench.methods.ablations import ABLATIONS
from adagmm_bench.methods.registry import Function, method
from adagmm_bench.methods.variant import Variant, replaced
from adagmm_bench.problem import Cloud
from adagmm_o3d import PointRegistrationResult, TransformationEstimationForAdaptiveGMM, register_points

VARIANTS = {
    "adagmm": Variant("This package with its default options."),
    "adagmm-paper": Variant(
        "The rule that gives the paper's accuracy: sigma from squared nearest distances, on both clouds.",
        {"sigma_rule": "nearest", "start": "init", "search": False},
    ),
    "adagmm-paper-literal": Variant(
        "The letter of the paper's Figure 2: sigma the mean nearest distance, on the source alone.",
        {"sigma_rule": "figure2", "start": "init", "search": False},
    ),
    "adagmm-global": Variant(
        'This package with init="global": it looks for the pose anywhere, then refines it with its default options.',
        init="global",
    ),
}


def register(name: str, source: Cloud, target: Cloud) -> PointRegistrationResult:
    """One of VARIANTS or ABLATIONS on two clouds, with its own record of the way."""
    variant = (VARIANTS | ABLATIONS)[name]
    with replaced(variant.replacements):
        return register_points(
            source.points,
            target.points,
            source.covariances,
            target.covariances,
            init=variant.init,
            estimation_method=TransformationEstimationForAdaptiveGMM(**variant.options),
            device="cpu",
        )


def _pose_by(name: str, meaning: str) -> Function:
    def pose(source: Cloud, target: Cloud) -> np.ndarray:
        return register(name, source, target).transformation

    pose.__doc__ = meaning
    return pose


for _name, _variant in (VARIANTS | ABLATIONS).items():
    method(
        _name,
        library="adagmm_o3d",
        ours=True,
        anywhere=_variant.init == "global",
        default=_name in VARIANTS,
    )(_pose_by(_name, _variant.meaning))
