"""The default with one choice undone at a time; `adagmm-bench ablation` runs them.

Choices that callers have no option for are constants and functions of the package, replaced while a row runs.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from adagmm_bench.methods.variant import Replacement, Variant
from adagmm_o3d.em.expectation import CLOSE_VOLUME, FINEST_SIGMA, SIGMA_FLOOR
from adagmm_o3d.mixtures.merging import MergedMixture
from adagmm_o3d.search.levels import APART_MERGED, KEPT_RANKING, MERGED, SMALL, Cascade
from adagmm_o3d.search.runs import End, Limits, Start, pose_distance, run_starts
from adagmm_o3d.search.starts import around

# All ends of a search are compared at this share of points without a partner, instead of each at its own.
ONE_SHARE = 0.1


def compared_at_one_share(
    source: MergedMixture, target: MergedMixture, starts: list[Start], *, limits: Limits, volume: float, level: int
) -> list[End]:
    """`run_starts`, the likelihood of every end taken at ONE_SHARE: EM of no iterations from the end tells it."""
    ends = run_starts(source, target, starts, limits=limits, volume=volume, level=level)
    again = [Start(end.pose, end.sigma, ONE_SHARE, fastest=1.0, iterations=0, follow=1.0) for end in ends]
    judged = run_starts(source, target, again, limits=limits, volume=volume, level=level)
    return [end._replace(log_likelihood=at.log_likelihood) for end, at in zip(ends, judged, strict=True)]


def run_starts_unaccelerated(
    source: MergedMixture, target: MergedMixture, starts: list[Start], *, limits: Limits, volume: float, level: int
) -> list[End]:
    limits = replace(limits, accelerated=False)
    return run_starts(source, target, starts, limits=limits, volume=volume, level=level)


def keep_the_step(residual: np.ndarray, deviation: float, memory: np.ndarray, step: np.ndarray) -> None:
    """In place of `accelerate`: `step` holds the residual already."""


def narrowed_by_the_sketch(cascade: Cascade, sketched: list[End], merged: End) -> list[End]:
    """The likeliest ends of the sketch that lead elsewhere, no level between it and the deciding one."""
    return [end for end in sketched if pose_distance(end.pose, merged.pose) > APART_MERGED][:KEPT_RANKING]


def shifted_only(pose: np.ndarray, dimension: int) -> list[Start]:
    return [start for start in around(pose, dimension) if (start.pose[:3, :3] == pose[:3, :3]).all()]


def turned_only(pose: np.ndarray, dimension: int) -> list[Start]:
    return [start for start in around(pose, dimension) if (start.pose[:3, 3] == pose[:3, 3]).all()]


ABLATIONS = {
    "adagmm-without-posterior": Variant(
        "The default with the paper's weights and an annealed sigma instead of posteriors.", {"sigma_rule": "annealed"}
    ),
    "adagmm-without-noise-floor": Variant(
        "The default with the paper's weights and its sigma, which points without a partner hold up.",
        {"sigma_rule": "nearest"},
    ),
    "adagmm-without-finest-sigma": Variant(
        "The default with sigma kept from following the residuals below the floor of the deciding level.",
        replacements=(
            Replacement("search.refinement", "SAMPLED_SIGMA", SIGMA_FLOOR),
            Replacement("search.refinement", "AT_FLOOR", 0.0),
        ),
    ),
    "adagmm-finest-sigma-everywhere": Variant(
        "The default with sigma free to follow the residuals on clouds of some thousand points as on dense ones.",
        replacements=(Replacement("search.refinement", "SAMPLED_SIGMA", FINEST_SIGMA),),
    ),
    "adagmm-without-mutuality": Variant(
        "The default with each pair's weight a share of the source point's alone, for large clouds too.",
        {"mutuality": 0.0},
    ),
    "adagmm-always-mutual": Variant(
        "The default with each pair's weight a share of both points', for small clouds too.", {"mutuality": 0.5}
    ),
    "adagmm-close-volume": Variant(
        "The default with points without a partner spread over little more than the clouds.",
        replacements=(Replacement("search.register", "OPEN_VOLUME", CLOSE_VOLUME),),
    ),
    "adagmm-without-acceleration": Variant(
        "The default with every step of the last refinement as EM gives it.",
        replacements=(
            Replacement("em.expectation", "accelerate", keep_the_step),
            Replacement("search.refinement", "run_starts", run_starts_unaccelerated),
        ),
    ),
    "adagmm-without-condensing": Variant(
        "The default with all points of dense clouds from the first iteration of the refinement on.",
        replacements=(Replacement("mixtures.condensing", "CONDENSED_FROM", math.inf),),
    ),
    "adagmm-without-parts": Variant(
        "The default with all points of dense clouds at once where the condensed ones have come to their end.",
        replacements=(Replacement("search.refinement", "SAMPLED_FROM", math.inf),),
    ),
    "adagmm-without-centroids": Variant("The default, started at the identity only.", {"start": "init"}),
    "adagmm-without-search": Variant(
        "The default without the search that follows a doubtful result.", {"search": False}
    ),
    "adagmm-always-searching": Variant(
        "The default with a search after a result without doubt too.",
        replacements=(Replacement("search.levels", "TIGHT", 0.0),),
    ),
    "adagmm-tight-at-any-overlap": Variant(
        "The default with tight residuals trusted however few points have a partner.",
        replacements=(Replacement("search.levels", "TIGHT_UNMATCHED", 1.0),),
    ),
    "adagmm-without-shifted-starts": Variant(
        "The default with a search among turned starts only.",
        replacements=(Replacement("search.starts", "around", turned_only),),
    ),
    "adagmm-without-turned-starts": Variant(
        "The default with a search among shifted starts only.",
        replacements=(Replacement("search.starts", "around", shifted_only),),
    ),
    "adagmm-without-sketch": Variant(
        f"The default with all starts of a search tried on {MERGED} components.",
        replacements=(Replacement("search.levels", "SKETCHED", {2: MERGED, 3: MERGED}),),
    ),
    "adagmm-decided-from-the-sketch": Variant(
        "The default with the ends of the sketch taken to the deciding level at once.",
        replacements=(Replacement("search.levels", "Cascade._narrowed", narrowed_by_the_sketch),),
    ),
    "adagmm-decided-on-all-points": Variant(
        "The default with a search among small clouds decided on all of their points.",
        replacements=(Replacement("search.levels", "SMALL_DECIDING", SMALL),),
    ),
    "adagmm-compared-at-one-share": Variant(
        f"The default with the ends of a search compared as if {ONE_SHARE:.0%} of the points had no partner.",
        replacements=(Replacement("search.levels", "run_starts", compared_at_one_share),),
    ),
}
