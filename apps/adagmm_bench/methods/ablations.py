"""The default with one choice undone at a time; `adagmm-bench ablation` runs them.

Choices that callers have no option for are constants and functions of the package, replaced while a row runs.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from adagmm_bench.methods.variant import Replacement, Variant
from adagmm_o3d.arguments import Array
from adagmm_o3d.em.expectation import FINEST_SIGMA
from adagmm_o3d.em.runs import Start
from adagmm_o3d.em.unmatched import AREA
from adagmm_o3d.grouping import CELL
from adagmm_o3d.mixtures.condensing import LEAST_ELONGATION, SIGMA_FLOOR
from adagmm_o3d.search.features import Alike
from adagmm_o3d.search.schedule import SCHEDULE
from adagmm_o3d.search.starts import around


def scheduled(**changes: Any) -> Replacement:
    """The search with another schedule."""
    return Replacement("search.register", "SCHEDULE", replace(SCHEDULE, **changes))


def no_features(alike: Alike) -> list[Array]:
    """In place of `feature_poses`: nothing is recognised."""
    return []


def turned_only(pose: Array, dimension: int) -> list[Start]:
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
            Replacement("mixtures.condensing", "LAST", SIGMA_FLOOR / CELL**2 / LEAST_ELONGATION),
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
    "adagmm-open-world": Variant(
        "The default with points without a partner taken for four times as thin as they are.",
        replacements=(Replacement("em.unmatched", "AREA", {d: 4.0 * area for d, area in AREA.items()}),),
    ),
    "adagmm-without-acceleration": Variant(
        "The default with every step of the last refinement as EM gives it.",
        replacements=(Replacement("search.refinement", "ACCELERATED", False),),
    ),
    "adagmm-without-condensing": Variant(
        "The default with all points of dense clouds from the start.",
        replacements=(Replacement("mixtures.condensing", "DENSE_FROM", math.inf),),
    ),
    "adagmm-without-centroids": Variant("The default, started at the identity only.", {"start": "init"}),
    "adagmm-without-search": Variant(
        "The default without the search that follows a doubtful result.", {"search": False}
    ),
    "adagmm-without-shifted-starts": Variant(
        "The default with a search among turned starts only.",
        replacements=(Replacement("search.starts", "around", turned_only),),
    ),
    "adagmm-without-sketch": Variant(
        f"The default with all starts of a search tried on {SCHEDULE.merged.size[1]} components.",
        replacements=(scheduled(sketch=replace(SCHEDULE.sketch, size=SCHEDULE.merged.size)),),
    ),
    "adagmm-decided-on-all-points": Variant(
        "The default with a search among small clouds decided on all of their points.",
        replacements=(scheduled(small_deciding=SCHEDULE.small),),
    ),
    "adagmm-without-features": Variant(
        "The default with no poses proposed by local features.",
        replacements=(Replacement("search.find", "feature_poses", no_features),),
    ),
}
