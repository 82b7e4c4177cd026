"""How to register, as callers say it: Open3D's criteria and estimation methods, and ours, checked at the door."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import open3d as o3d

from .criteria import Criteria
from .errors import InputError, InputTypeError
from .options import DEFAULT_MAX_ITERATION, DEFAULT_RELATIVE_RMSE, TransformationEstimationForAdaptiveGMM

# What is called after each EM iteration, with what `registration_adaptive_gmm` says of it.
Callback = Callable[[dict[str, Any]], None]

LEGACY, TENSOR = o3d.pipelines.registration, o3d.t.pipelines.registration


def check_estimation_method(value: Any) -> TransformationEstimationForAdaptiveGMM:
    """The options of `estimation_method`; None and Open3D's own methods stand for the defaults.

    Raises
    ------
    InputTypeError : neither ours nor Open3D's, or a class in place of an instance.
    InputError : one of Open3D's that estimates a scale.
    """
    if value is None:
        return TransformationEstimationForAdaptiveGMM()
    if isinstance(value, TransformationEstimationForAdaptiveGMM):
        return value
    if not isinstance(value, (LEGACY.TransformationEstimation, TENSOR.TransformationEstimation)):
        got = f"the class {value.__name__}; add ()" if isinstance(value, type) else type(value).__name__
        raise InputTypeError(
            f"estimation_method: expected TransformationEstimationForAdaptiveGMM() or one of Open3D's, got {got}"
        )
    if getattr(value, "with_scaling", False):
        raise InputError(
            "estimation_method: with_scaling is on, but a rigid registration estimates no scale; turn it off"
        )
    return TransformationEstimationForAdaptiveGMM()


def check_criteria(value: Any) -> Criteria:
    """When to stop, from Open3D's ICPConvergenceCriteria, legacy or tensor; None for the defaults.

    Raises
    ------
    InputTypeError : something else.   InputError : a number of it out of range.
    """
    if value is None:
        return Criteria(DEFAULT_RELATIVE_RMSE, DEFAULT_MAX_ITERATION)
    if not isinstance(value, (LEGACY.ICPConvergenceCriteria, TENSOR.ICPConvergenceCriteria)):
        raise InputTypeError(f"criteria: expected Open3D's ICPConvergenceCriteria, got {type(value).__name__}")
    if value.max_iteration < 1:
        raise InputError(f"criteria.max_iteration: expected at least 1, got {value.max_iteration}")
    if not 0.0 <= value.relative_rmse < math.inf:
        raise InputError(f"criteria.relative_rmse: expected a finite number >= 0, got {value.relative_rmse:g}")
    return Criteria(float(value.relative_rmse), int(value.max_iteration))


def check_callback(value: Any) -> Callback | None:
    """The function to call after each iteration, or None.

    Raises
    ------
    InputTypeError : not callable.
    """
    if value is not None and not callable(value):
        raise InputTypeError(
            f"callback_after_iteration: expected a function of one dictionary, got {type(value).__name__}"
        )
    return value
