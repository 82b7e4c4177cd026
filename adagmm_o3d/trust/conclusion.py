"""From the end of the EM loop to the result: back to input units, and what speaks against the pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.em.loop import Outcome
from adagmm_o3d.mixtures.colours import ColourModel
from adagmm_o3d.mixtures.mixture import Mixture
from adagmm_o3d.mixtures.normalisation import Normalisation
from adagmm_o3d.result import (
    ColorFit,
    Deferred,
    Partners,
    PointRegistrationResult,
    PoseUncertainty,
    StopReason,
    Verdict,
)

# Residuals of this variance (a standard deviation of a tenth of the radius) are heavy noise or a wrong pose.
LARGEST_SIGMA = 0.01


class Answers(NamedTuple):
    """What a result finds out only when it is asked; see the fields of `PointRegistrationResult`."""

    find_partners: Callable[[], Partners]
    assess: Callable[[], PoseUncertainty]
    weigh: Callable[[], Verdict | None]
    compare_colors: Callable[[], Array] | None = None


def conclude(
    start: Array,
    outcome: Outcome,
    normalisation: Normalisation,
    source: Mixture,
    target: Mixture,
    answers: Answers,
    *,
    ambiguous: bool,
    colour: ColourModel | None = None,
) -> PointRegistrationResult:
    """The result of normalised mixtures in input units."""
    poses = np.array([start, *(i.pose for i in outcome.iterations)])
    poses = lower(normalisation.pose_out(poses), source.dimension)
    return PointRegistrationResult(
        transformation=poses[-1].copy(),
        stop_reason=outcome.stop_reason,
        iterations=len(outcome.iterations),
        sigmas=np.array([normalisation.sigma_out(i.sigma) for i in outcome.iterations]),
        energies=np.array([i.energy for i in outcome.iterations]),
        transformations=poses,
        dropped_source=source.dropped,
        dropped_target=target.dropped,
        regularised_source=source.regularised,
        regularised_target=target.regularised,
        ambiguous=ambiguous,
        doubts=_doubts(outcome, ambiguous),
        find_partners=Deferred(answers.find_partners),
        assess=Deferred(answers.assess),
        weigh=Deferred(answers.weigh),
        color=None if colour is None else ColorFit(colour.deviations, colour.lying, colour.gain, colour.offset),
        compare_colors=None if answers.compare_colors is None else Deferred(answers.compare_colors),
    )


def _doubts(outcome: Outcome, ambiguous: bool) -> tuple[str, ...]:
    doubts = []
    if outcome.stop_reason is not StopReason.CONVERGED:
        doubts.append(f"not converged: {outcome.stop_reason}")
    if outcome.iterations and outcome.iterations[-1].sigma > LARGEST_SIGMA:
        deviation = np.sqrt(outcome.iterations[-1].sigma)
        doubts.append(f"residuals of {deviation:.0%} of the clouds' radius remain: heavy noise or a wrong pose")
    if ambiguous:
        doubts.append("another pose explains the clouds as well: a symmetric shape")
    return tuple(doubts)


def lower(poses: Array, dimension: int) -> Array:
    """(…, 4, 4) poses → (…, D+1, D+1)."""
    if dimension == 3:
        return poses
    keep = np.array([0, 1, 3])
    return np.ascontiguousarray(poses[..., keep[:, None], keep])
