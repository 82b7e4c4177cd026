"""How to register, as callers say it: every tunable with its unit, default and range, and Open3D's criteria and
estimation methods, checked at the door."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from adagmm_o3d.arguments import float_array, of_moderate_length, real_number, true_or_false, whole_number
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.kernels.limits import EPSILON
from adagmm_o3d.lazy_open3d import is_installed, o3d

DEFAULT_MAX_ITERATION = 200
DEFAULT_RELATIVE_RMSE = 1e-3
# relative_fitness, relative_rmse and max_iteration of Open3D's ICPConvergenceCriteria() when nobody chose them.
OPEN3D_DEFAULTS = (1e-6, 1e-6, 30)
# Largest entry of RᵀR − I in a pose to start from, which is then made exact: its entries are 5e-3 off. A rotation with
# three digits has up to 2e-3; a scale, a shear or a reflection that somebody could mean has more than this.
INIT_TOLERANCE = 1e-2

SigmaRuleName = Literal["posterior", "annealed", "nearest", "figure2"]
StartName = Literal["auto", "init", "centroids"]
# What is called after each EM iteration, with what `registration_adaptive_gmm` says of it.
Callback = Callable[[dict[str, Any]], None]

DeviceName = Literal["auto", "cpu", "cuda"]

if TYPE_CHECKING:
    Open3DEstimation: TypeAlias = (
        o3d.pipelines.registration.TransformationEstimation | o3d.t.pipelines.registration.TransformationEstimation
    )
    Open3DCriteria: TypeAlias = (
        o3d.pipelines.registration.ICPConvergenceCriteria | o3d.t.pipelines.registration.ICPConvergenceCriteria
    )
    EstimationMethod: TypeAlias = "TransformationEstimationForAdaptiveGMM | Open3DEstimation | None"
    CriteriaArgument: TypeAlias = "Criteria | Open3DCriteria | None"
else:  # nothing of Open3D is imported for them
    EstimationMethod = CriteriaArgument = Any

# What an estimation method of Open3D looks at and ours does not.
UNUSED = {
    "TransformationEstimationForDopplerICP": "Doppler velocities are not looked at",
}

_log = logging.getLogger("adagmm_o3d")


@dataclass(frozen=True)
class Criteria:
    """When an EM iteration has changed nothing worth another one; the words and numbers are Open3D's.

    The residual is flat at its minimum: a step of ε standard deviations changes it by about ε². So a pose has settled
    when a step is below √relative_rmse standard deviations of the mixtures. max_iteration bounds the iterations that
    are reported, and with them those on all points, see `PointRegistrationResult.iterations`; at 0 the start is the
    result.
    """

    relative_rmse: float
    max_iteration: int


@dataclass(frozen=True)
class TransformationEstimationForAdaptiveGMM:
    """Options of `registration_adaptive_gmm` and `register_points`; the defaults are the ones measured to be best.

    sigma_rule : how pairs are weighed and how the scale σ of the mixtures follows the registration.
        "posterior": pairs weigh what they are probable to be the same place, given both clouds; σ is what the residuals
            of these pairs say, so that it ignores points without a partner and stops at the noise.
        "annealed": the paper's weights; σ from the nearest distances until the pose settles, then ever smaller.
        "nearest": the paper's weights; σ is the mean squared nearest distance over the dimension, for both clouds (it
            reproduces the published accuracy).
        "figure2": the paper's weights; σ is the mean nearest distance, for the source alone (the letter of Figure 2).
    start : where to begin when `init` is the identity or left out.
        "auto": at the identity or with common centroids, whichever explains the clouds better.
        "init": at the identity.   "centroids": with common centroids (the paper).
    search : where the first results leave doubt, try other starts and what features propose, and let the judge decide.
        False: only the nearest optimum to `init`, or the identity, and where the wide start from there leads compete.
    mutuality : 0 to 0.5, how much of a pair's weight is its share among the target point's pairs, beside that among the
        source point's (0.5: both alike). None: 0.5 for clouds of more than 1100 points, where it pays; 0 for smaller
        ones, where it costs accuracy under heavy noise.
    color : also look at the colours, or intensities, of both clouds, which then have to have some: points whose colours
        are alike are likelier to be the same place. It helps where the shape leaves the pose open.
    relaxation : lengthens every step of the last level, 1 <= relaxation < 2. Above 1 it saves iterations with the
        paper's weights; with "posterior", whose steps are extrapolated anyway, hardly any.
    gravity : (3,) its direction in both clouds, of any length, up or down, e.g. (0, 0, 1) for scans that are level;
        then only the turn about it and the translation are estimated. Clouds whose directions differ are to be turned
        first, and `init` must keep it to half a degree. None: all turns.

    Raises
    ------
    InputTypeError, InputError : an option out of its range.
    """

    sigma_rule: SigmaRuleName = "posterior"
    start: StartName = "auto"
    search: bool = True
    mutuality: float | None = None
    relaxation: float = 1.0
    color: bool = False
    gravity: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        for name, choices in (("sigma_rule", get_args(SigmaRuleName)), ("start", get_args(StartName))):
            value = getattr(self, name)
            if not isinstance(value, str) or value not in choices:
                got = repr(value) if isinstance(value, str) else type(value).__name__
                raise InputError(f"{name}: expected one of {', '.join(map(repr, choices))}, got {got}")
        for name in ("search", "color"):
            self._keep(name, true_or_false(name, getattr(self, name)))
        if self.mutuality is not None:
            self._keep("mutuality", real_number("mutuality", self.mutuality))
            if not 0.0 <= self.mutuality <= 0.5:
                raise InputError(f"mutuality: expected 0 <= mutuality <= 0.5 or None, got {self.mutuality:g}")
        self._keep("relaxation", real_number("relaxation", self.relaxation))
        if not 1.0 <= self.relaxation < 2.0:
            raise InputError(f"relaxation: expected 1 <= relaxation < 2, got {self.relaxation:g}")
        if self.gravity is not None:
            direction = of_moderate_length(float_array("gravity", self.gravity, (3,)))
            if not direction.any():
                raise InputError("gravity: expected a direction (3,), got zero; leave it out where it is not known")
            self._keep("gravity", tuple((direction / np.linalg.norm(direction)).tolist()))

    def _keep(self, name: str, value: Any) -> None:
        """Put an option as it was read in the place of what was given."""
        object.__setattr__(self, name, value)


def check_estimation_method(value: Any) -> TransformationEstimationForAdaptiveGMM:
    """The options of `estimation_method`; None and Open3D's own methods, said once on the log, stand for the defaults,
    that for coloured ICP for `color`.

    Raises
    ------
    InputTypeError : neither ours nor Open3D's, or a class in place of an instance.
    InputError : one of Open3D's that estimates a scale.
    """
    if value is None:
        return TransformationEstimationForAdaptiveGMM()
    if isinstance(value, TransformationEstimationForAdaptiveGMM):
        return value
    if not _is_open3ds("TransformationEstimation", value):
        got = f"the class {value.__name__}; add ()" if isinstance(value, type) else type(value).__name__
        raise InputTypeError(
            f"estimation_method: expected TransformationEstimationForAdaptiveGMM() or one of Open3D's, got {got}"
        )
    if getattr(value, "with_scaling", False):
        raise InputError(
            "estimation_method: with_scaling is on, but a rigid registration estimates no scale; turn it off"
        )
    color = type(value).__name__ == "TransformationEstimationForColoredICP"
    _say_what_stands_for(type(value).__name__, _robust_kernel(value), "color=True" if color else "")
    return TransformationEstimationForAdaptiveGMM(color=color)


def _is_open3ds(name: str, value: object) -> bool:
    """Whether a value is of one of Open3D's two classes of that name."""
    if not is_installed():
        return False
    kinds = o3d.pipelines.registration, o3d.t.pipelines.registration
    return isinstance(value, tuple(getattr(kind, name) for kind in kinds))


def surface_thickness(estimation_method: Any) -> float | None:
    """The variance across the surface of covariances that a cloud lacks: `epsilon` of Open3D's method for GICP; None
    where nobody gave any.

    Open3D takes 0, with which covariances are singular, and more than 1, with which no surface is meant: they stand for
    EPSILON, as with any singular covariance, and for 1.

    Raises
    ------
    InputError : an epsilon that is below zero or not finite.
    """
    if estimation_method is None or not is_installed():
        return None
    if not isinstance(estimation_method, o3d.pipelines.registration.TransformationEstimationForGeneralizedICP):
        return None
    epsilon = real_number("estimation_method.epsilon", estimation_method.epsilon, minimum=0.0)
    return min(epsilon, 1.0) if epsilon > 0.0 else EPSILON


def _robust_kernel(method: Any) -> str | None:
    """The name of the robust kernel that one of Open3D's methods was given, unless it is the one that does nothing."""
    kernel = getattr(method, "kernel", None)
    if kernel is None:
        return None
    of_tensors = isinstance(kernel, o3d.t.pipelines.registration.robust_kernel.RobustKernel)
    name: str = kernel.type.name if of_tensors else type(kernel).__name__
    return None if name == "L2Loss" else name


@cache
def _say_what_stands_for(method: str, kernel: str | None, options: str) -> None:
    """What becomes of one of Open3D's methods; a warning where something that its user chose has no counterpart."""
    dropped = [UNUSED[method]] if method in UNUSED else []
    if kernel is not None:
        dropped.append(f"the robust kernel {kernel} is not needed, as points without a partner have no weight")
    _log.log(
        logging.WARNING if dropped else logging.INFO,
        "estimation_method: %s stands for TransformationEstimationForAdaptiveGMM(%s)%s",
        method,
        options,
        "".join(f"; {reason}" for reason in dropped),
    )


def check_criteria(value: Any, *, name: str = "criteria") -> Criteria:
    """When to stop, from Open3D's ICPConvergenceCriteria, or `Criteria`; None and Open3D's defaults for ours.

    `name` is what an error calls it. `relative_fitness` is not read: the share of points with a partner settles with
    the pose.

    Raises
    ------
    InputTypeError : something else, or what is no number of it.   InputError : a number of it out of range.
    """
    ours = Criteria(DEFAULT_RELATIVE_RMSE, DEFAULT_MAX_ITERATION)
    if value is None:
        return ours
    if not isinstance(value, Criteria) and not _is_open3ds("ICPConvergenceCriteria", value):
        raise InputTypeError(f"{name}: expected Open3D's ICPConvergenceCriteria, got {type(value).__name__}")
    relative_rmse = real_number(f"{name}.relative_rmse", value.relative_rmse, minimum=0.0)
    max_iteration = whole_number(f"{name}.max_iteration", value.max_iteration, minimum=0)
    if not isinstance(value, Criteria) and (value.relative_fitness, relative_rmse, max_iteration) == OPEN3D_DEFAULTS:
        return ours
    return Criteria(relative_rmse, max_iteration)


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
