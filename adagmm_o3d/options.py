"""Every tunable of the method, with its unit, default and range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from .arguments import real_number
from .errors import InputError, InputTypeError

DEFAULT_MAX_ITERATION = 200
DEFAULT_RELATIVE_RMSE = 1e-3

SigmaRuleName = Literal["posterior", "annealed", "nearest", "figure2"]
StartName = Literal["auto", "init", "centroids"]


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
    search : where the first result leaves doubt, try other starts too and let the likelihood decide.
    mutuality : 0 to 0.5, how much of a pair's weight is its share among the target point's pairs, beside that among the
        source point's (0.5: both alike). None: 0.5 for clouds of more than 1100 points, where it pays; 0 for smaller
        ones, where it costs accuracy under heavy noise.
    relaxation : lengthens every step, 1 <= relaxation < 2; above 1 it saves iterations.

    Raises
    ------
    InputTypeError, InputError : an option out of its range.
    """

    sigma_rule: SigmaRuleName = "posterior"
    start: StartName = "auto"
    search: bool = True
    mutuality: float | None = None
    relaxation: float = 1.0

    def __post_init__(self) -> None:
        for name, choices in (("sigma_rule", get_args(SigmaRuleName)), ("start", get_args(StartName))):
            value = getattr(self, name)
            if value not in choices:
                raise InputError(f"{name}: expected one of {', '.join(map(repr, choices))}, got {value!r}")
        if not isinstance(self.search, bool):
            raise InputTypeError(f"search: expected a bool, got {type(self.search).__name__}")
        if self.mutuality is not None and not 0.0 <= real_number("mutuality", self.mutuality) <= 0.5:
            raise InputError(f"mutuality: expected 0 <= mutuality <= 0.5 or None, got {self.mutuality:g}")
        if not 1.0 <= real_number("relaxation", self.relaxation) < 2.0:
            raise InputError(f"relaxation: expected 1 <= relaxation < 2, got {self.relaxation:g}")
