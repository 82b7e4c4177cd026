"""What the estimate gets wrong, and what it could not know: marks and words in the 3D scene."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.colors import BAD_COLOR, DIFFERENCE_COLOR, LABEL_COLOR, UNOBSERVABLE_COLOR
from adagmm_fusion.rerun_log.eyes import DIRECTION
from adagmm_fusion.rerun_log.iterations import pose_errors
from adagmm_fusion.rerun_log.when import When

ARROW_RADIUS = 0.012


def log_difference(
    rec: rr.RecordingStream, T_estimate: np.ndarray, T_truth: np.ndarray | None, when: When, *, bad: bool = False
) -> None:
    """An arrow from the estimated to the true place of the source sensor, the difference written beside it; red if
    `bad`."""
    if T_truth is None:
        when.clear(rec, entities.DIFFERENCE)
        return
    angle_deg, distance_mm = (float(e[0]) for e in pose_errors(T_estimate[None], T_truth))
    arrow = rr.Arrows3D(
        origins=T_estimate[:3, 3],
        vectors=T_truth[:3, 3] - T_estimate[:3, 3],
        radii=0.5 * ARROW_RADIUS,
        colors=BAD_COLOR if bad else DIFFERENCE_COLOR,
    )
    when.log(rec, entities.DIFFERENCE, arrow)
    words = f"{angle_deg:.2f}°, {distance_mm:.0f} mm off{': bad' if bad else ''}"
    middle = 0.5 * (T_estimate[:3, 3] + T_truth[:3, 3])
    when.log(rec, f"{entities.DIFFERENCE}/label", _labels(middle[None], [words]))


def log_unobservable(
    rec: rr.RecordingStream, unobservable: Sequence[np.ndarray], source: np.ndarray, target: np.ndarray, when: When
) -> None:
    """An arrow for each direction that the clouds leave free: along it the source slides, or about it it turns.

    unobservable : unit tangents (ω, v) (6,), target's axes, about its centroid, in units of the clouds' RMS radius.
    source, target : (M, 3), (N, 3) [m], in the target's frame, the source at the estimate.
    """
    if len(unobservable) == 0:
        when.clear(rec, entities.UNOBSERVABLE)
        return
    radius = max(np.sqrt(((p - p.mean(axis=0)) ** 2).sum(axis=1).mean()) for p in (source, target))
    origins, vectors, labels = [], [], []
    for tangent in unobservable:
        turn, slide = np.asarray(tangent[:3]), np.asarray(tangent[3:])
        turns = np.linalg.norm(turn) > np.linalg.norm(slide)
        direction = turn if turns else slide
        direction = direction if direction @ DIRECTION > 0.0 else -direction  # towards the eye, not into the surface
        vectors.append(radius * direction / np.linalg.norm(direction))
        # A turn about an axis elsewhere is a turn about the centroid and a slide.
        off_axis = radius * np.cross(turn, slide) / (turn @ turn) if turns else 0.0
        origins.append(target.mean(axis=0) + off_axis)
        labels.append("free to turn" if turns else "free to slide")
    starts, along = np.array(origins), np.array(vectors)
    arrows = rr.Arrows3D(origins=starts, vectors=along, radii=ARROW_RADIUS, colors=UNOBSERVABLE_COLOR)
    when.log(rec, entities.UNOBSERVABLE, arrows)
    when.log(rec, f"{entities.UNOBSERVABLE}/label", _labels(starts + 0.5 * along, labels))


def _labels(places: np.ndarray, words: Sequence[str]) -> rr.Points3D:
    """Words at places (n, 3). The viewer writes a label in its owner's colour, on a box whose colour is its theme's:
    white is read on both."""
    return rr.Points3D(places, colors=LABEL_COLOR, radii=0.0, labels=words, show_labels=True)
