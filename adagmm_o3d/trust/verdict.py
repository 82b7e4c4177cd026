"""Whether to believe the pose that was found, from the few things that tell right ones from wrong ones.

A wrong pose may be found with as large an overlap as the right one, and explain the clouds as well as a right pose of
clouds that share less. What sets them apart: where the clouds come near each other, their surfaces agree as far as the
halves of one cloud do (`agreement`), that holds for enough of them, and no other pose does as well (`rivals`), nor what
can only be wrong, the mirror image of the source (`mirror`): where that does, what agrees may be chance. These go
together into one logistic regression, with a weight for each, of outcomes for which the truth is known; a right and
a wrong outcome count as equally likely beforehand, so that a belief of a half is where in doubt one warns.

The weights are fitted on generated pairs alone: parts of models and rooms bent as sensors bend, halves, mirror images,
boxes half a turn off, the simulations; that of the mirror image later, the others held, on cluttered scenes seen from
two sides as well. Recorded and public pairs are held out of the fit; the choice of the signs was made with some of them
in sight.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from adagmm_o3d.arguments import Array
from adagmm_o3d.result import LEAST_BELIEF, Verdict
from adagmm_o3d.trust.agreement import Surface, agreement, surfaces_of
from adagmm_o3d.trust.edges import share_beyond_edges
from adagmm_o3d.trust.judge import JUDGED, Judge
from adagmm_o3d.trust.mirror import MirrorImage, fit_mirror_image
from adagmm_o3d.trust.rivals import half_turned
from adagmm_o3d.trust.scale import estimate_scale

# So few points are no surface.
LEAST_POINTS = 30
# The margin of a rival counts within these bounds, and shares from this one up.
MARGINS, LEAST = (-0.5, 0.5), 0.05
# The mirror image of the source speaks against a pose where it explains the clouds better by so much [nats per point],
# where so much more of both agrees, of so many points (of fewer by more, as chance grows with the root of it), and
# where that is nearly all. Bodies that are their own image reach 0.1 and 0.01, of 240 points 0.5 and 0.1.
MIRRORED, MORE, OF_POINTS, NEARLY_ALL = 0.15, 0.04, 2 * JUDGED, 0.9
# But the left half of such a body is the image of its right half: it does not speak against a pose that leaves so much
# of what is not shared beyond an edge of the clouds. Of such halves it is 0.97, of mirrored bodies 0.1 to 0.4.
BEYOND = 0.7
# The margin over the mirror image counts within these.
MARGINS_OVER_IMAGE = (0.0, 1.0)
# Of the signs in their order, and the constant.
WEIGHTS, CONSTANT = (11.9, 3.0, 6.9, 1.5), 0.15


def weigh(judge: Judge, pose: Array, *, turned: bool) -> Verdict:
    """What speaks for a pose (4, 4) between the judge's normalised mixtures; `turned` says that their places are
    changed."""
    evidence, sides = judge.confidence(pose), judge.sides
    if min(len(side.points) for side in sides) < LEAST_POINTS:
        return Verdict(evidence)
    source, target = surfaces_of(*sides)
    agreed = agreement(source, target, pose)
    rivals = [judge.confidence(rival, 1.0) for rival in half_turned(sides, pose)]
    margin = judge.confidence(pose, 1.0) - max(rivals, default=-math.inf)
    verdict = Verdict(evidence, share=agreed.share, relative=agreed.relative, margin=margin)
    scale = estimate_scale(source, target, pose, sides[0].dimension)
    if scale is not None and scale.differs:
        verdict = replace(verdict, scale=1.0 / scale.factor if turned else scale.factor)
    if believe(signs(replace(verdict, over_image=math.inf))) >= LEAST_BELIEF:
        image = fit_mirror_image(judge, pose)
        mirrored = _contradicts(image, source, target, pose, agreed.share)
        verdict = replace(verdict, over_image=-image.margin, mirrored=mirrored)
    return replace(verdict, belief=believe(signs(verdict)))


def _contradicts(image: MirrorImage, source: Surface, target: Surface, pose: Array, share: float) -> bool:
    """Whether the mirror image of the source says that a pose, at which this share agrees, is wrong."""
    chance = math.sqrt(OF_POINTS / (len(source.points) + len(target.points)))
    if image.margin < chance * MIRRORED:
        return False
    surfaces = surfaces_of(image.source, image.target)
    if agreement(*surfaces, image.pose).share < max(share + chance * MORE, NEARLY_ALL):
        return False
    return share_beyond_edges(source, target, pose) < BEYOND


def signs(verdict: Verdict) -> Array:
    """(4,) what the regression goes by: the logarithms of relative agreement and of agreeing shares, and the margins
    over half a turn and over the mirror image."""
    assert verdict.relative is not None and verdict.share is not None and verdict.margin is not None
    over_image = 0.0 if verdict.over_image is None else verdict.over_image
    # a mirrored body is a rival like half a turn; of one that is its own image, and right, the image fits as well
    margin = min(verdict.margin, over_image) if verdict.mirrored else verdict.margin
    return np.array(
        [
            math.log(min(max(verdict.relative, LEAST), 1.0)),  # better than a cloud's own halves is no sign of more
            math.log(max(verdict.share, LEAST)),
            np.clip(margin, *MARGINS),
            np.clip(over_image, *MARGINS_OVER_IMAGE),
        ]
    )


def believe(signs: Array) -> float:
    """The probability that a pose with these signs is right."""
    return 1.0 / (1.0 + math.exp(-(float(signs @ WEIGHTS) + CONSTANT)))
