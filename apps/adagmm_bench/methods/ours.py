"""Adaptive Gaussian mixtures: the variants that the reports tell apart, and the default with one choice undone."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import open3d as o3d

from adagmm_bench.methods.ablations import ABLATIONS
from adagmm_bench.methods.registry import Function, method
from adagmm_bench.methods.variant import Variant, replaced
from adagmm_bench.problem import Cloud
from adagmm_o3d import (
    PointRegistrationResult,
    TransformationEstimationForAdaptiveGMM,
    register_points,
    registration_adaptive_gmm,
)

TAKES_VIEWPOINTS = all(
    {"source_viewpoint", "target_viewpoint"} <= set(inspect.signature(function).parameters)
    for function in (register_points, registration_adaptive_gmm)
)

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
if TAKES_VIEWPOINTS:
    VARIANTS["adagmm-viewpoints"] = Variant(
        "This package with its default options, told where the sensors stood.", viewpoints=True
    )
# They differ from the default only where viewpoints are known.
NAMED_ONLY = {"adagmm-viewpoints", *ABLATIONS}


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
            **_viewpoints(variant, source.viewpoint, target.viewpoint),
        )


def register_clouds(
    name: str,
    source: o3d.geometry.PointCloud,
    target: o3d.geometry.PointCloud,
    distance: float,
    *,
    init: np.ndarray,
    source_viewpoint: np.ndarray | None = None,
    target_viewpoint: np.ndarray | None = None,
) -> PointRegistrationResult:
    """One of VARIANTS or ABLATIONS as an Open3D script calls it.

    distance : what fitness counts within; `init` : (4, 4), for variants that do not search anywhere.
    """
    variant = (VARIANTS | ABLATIONS)[name]
    with replaced(variant.replacements):
        return registration_adaptive_gmm(
            source,
            target,
            distance,
            init if variant.init is None else variant.init,
            TransformationEstimationForAdaptiveGMM(**variant.options),
            device="cpu",
            **_viewpoints(variant, source_viewpoint, target_viewpoint),
        ).details


def _viewpoints(variant: Variant, source: np.ndarray | None, target: np.ndarray | None) -> dict[str, Any]:
    if not variant.viewpoints or source is None or target is None:
        return {}
    return {"source_viewpoint": source, "target_viewpoint": target}


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
        default=_name not in NAMED_ONLY,
    )(_pose_by(_name, _variant.meaning))
