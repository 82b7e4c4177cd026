"""Whether to believe the pose that was found, from the few things that tell right ones from wrong ones.

A wrong pose may be found with as large an overlap as the right one, and explain the clouds as well as a right pose of
clouds that share less. What sets them apart: where the surface of either cloud goes on, the other lies on it, as far as
the halves of one cloud do (`agreement`); and no other pose does as well, neither one that is turned from there
(`rivals`) nor what can only be wrong, the mirror image of the source (`mirror`). These go together
into one logistic regression, with a weight for each, of outcomes for which the truth is known; a right and a wrong
outcome count as equally likely beforehand, so that a belief of a half is where in doubt one warns. A shape that repeats
itself is said to (`repetition`), however well it fits.

The weights are fitted to generated pairs alone, of bodies, machines, rooms and clutter: `adagmm-bench belief` makes
them, registers them and prints the weights. Recorded and public pairs are held out of the fit; the choice of the signs
was made with some of them in sight.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.result import LEAST_BELIEF, Verdict
from adagmm_o3d.trust.agreement import Agreement, Surface, agreement, log_held
from adagmm_o3d.trust.judge import JUDGED, Judge
from adagmm_o3d.trust.mirror import REFLECTION, MirrorImage, fit_mirror_image
from adagmm_o3d.trust.repetition import repeats_itself
from adagmm_o3d.trust.rivals import margin_over_turned
from adagmm_o3d.trust.scale import estimate_scale
from adagmm_o3d.trust.tilt import estimate_tilt

# The mirror image of the source must be one where it explains the clouds better by so much [nats per point], where so
# much more of both agrees, of so many points (of fewer by more, as chance grows with the root of it), and where that is
# nearly all. Bodies that are their own image reach 0.1 and 0.01, of 240 points 0.5 and 0.1.
MIRRORED, MORE, OF_POINTS, NEARLY_ALL = 0.15, 0.04, 2 * JUDGED, 0.9
# But the left half of such a body is the image of its right half: an image that does better says nothing of a pose that
# leaves so much of what is not shared beyond an edge of the clouds. Of such halves it is 0.97, of mirrored bodies 0.1
# to 0.4.
BEYOND = 0.7
# The signs count within these: the margin over what is turned, near none; that of an image that does better; the one
# over the nearest of both.
TURNED, BETTER_IMAGE, NEAREST = (-0.3, 0.3), (-0.3, 0.0), (0.0, 1.0)
# Of the signs in their order, and the constant.
WEIGHTS, CONSTANT = (9.8, 5.4, 9.2, 2.8), 0.1
# A rival is looked for where without it the pose would be believed by so much.
LOOKED_AT = LEAST_BELIEF


def weigh(judge: Judge, pose: Array, *, turned: bool, gravity: Array | None = None) -> Verdict:
    """What speaks for a pose (4, 4) between the judge's normalised mixtures; `turned` says that their places are
    changed, `gravity` (3,) is the axis that held the pose, if one did."""
    evidence, sides = judge.confidence(pose), judge.sides
    if judge.too_few:
        return Verdict(evidence)
    source, target = judge.surfaces
    agreed = agreement(source, target, pose)
    verdict = Verdict(evidence, share=agreed.share, held=agreed.held)
    scale = estimate_scale(source, target, pose, sides[0].dimension)
    if scale is not None and scale.differs:
        verdict = replace(verdict, scale=1.0 / scale.factor if turned else scale.factor)
    if gravity is not None:
        verdict = replace(verdict, tilt=estimate_tilt(source, target, pose, gravity))
    if believe(signs(verdict)) >= LOOKED_AT:
        verdict = replace(verdict, margin=margin_over_turned(judge, pose, agreed.held))
    if believe(signs(verdict)) >= LOOKED_AT:
        image = fit_mirror_image(judge, pose)
        # parts of a body that is its own image share less than its left half and the image of its right half
        speaks = image.margin < 0.0 or agreed.beyond < BEYOND
        mirrored = speaks and _is_mirrored(image, source, target, agreed)
        verdict = replace(verdict, over_image=-image.margin if speaks else 0.0, mirrored=mirrored)
    belief = believe(signs(verdict))
    repeats = belief >= LOOKED_AT and sides[0].dimension == 3 and repeats_itself(judge, source, target, pose)
    return replace(verdict, repeats=repeats, belief=belief)


def _is_mirrored(image: MirrorImage, source: Surface, target: Surface, agreed: Agreement) -> bool:
    """Whether the mirror image of the source fits so clearly better than it does itself that it must be one."""
    chance = math.sqrt(OF_POINTS / (len(source.points) + len(target.points)))
    if image.margin < chance * MIRRORED:
        return False
    share = agreement(source.reflected(REFLECTION), target, image.pose).share
    return share >= max(agreed.share + chance * MORE, NEARLY_ALL)


def signs(verdict: Verdict) -> Array:
    """(4,) what the regression goes by: the logarithm of what holds, the margins over what is turned and over a mirror
    image that does better, and that over the nearest of these rivals."""
    assert verdict.held is not None
    margin, over_image = (math.inf if found is None else found for found in (verdict.margin, verdict.over_image))
    return np.array(
        [
            log_held(verdict.held),
            np.clip(margin, *TURNED),
            np.clip(over_image, *BETTER_IMAGE),
            np.clip(min(margin, over_image), *NEAREST),
        ]
    )


def believe(signs: Array) -> float:
    """The probability that a pose with these signs is right."""
    return 1.0 / (1.0 + math.exp(-(float(signs @ WEIGHTS) + CONSTANT)))
