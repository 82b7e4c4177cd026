"""Why a pair came out as it did, in one sentence, chosen by the evidence at hand."""

from dataclasses import dataclass

from adagmm_fusion.pairs.feature_start import left_behind
from adagmm_fusion.pairs.stages import FEATURES, Stage, worse_than_start

# A start within this many times the limits of success was nearly right: what went wrong came later.
NEARLY = 1.5
# What a correlation of colours has lost where it counts.
COLORS_LOST = 0.1
# Overlaps that differ by less are the same; below the second the clouds have little in common.
SAME_OVERLAP, LITTLE_OVERLAP = 0.02, 0.4
# Of a motion that only slides along surfaces, less than this goes across them.
SLIDES = 0.4
# The truth rather is wrong where so much less of the clouds meets at it, and nothing speaks against the end.
TRUTH_LOST = 0.3


@dataclass(frozen=True)
class Evidence:
    """What is known of a pair; None, 0 or False where nothing is.

    status, reason : as judged.    start, end : its stages, None if it could not be registered.
    max_rotation_deg, max_translation_mm : up to which a pose counts as right.
    feature_inliers, feature_matches : of the start, where features gave it; agreeing_features : at the end.
    overlap_truth : share of source points with a partner at the ground truth.
    moved_mm, across : how far the source's points moved from start to end, and the share of that across the surfaces.
    ambiguous, chance_fit, converged, free_directions : what the registration says of itself.
    mirrored : the features of the images agree only if one of them is flipped.
    """

    status: str
    reason: str = ""
    start: Stage | None = None
    end: Stage | None = None
    max_rotation_deg: float = 3.0
    max_translation_mm: float = 100.0
    feature_inliers: int = 0
    feature_matches: int = 0
    agreeing_features: int | None = None
    overlap_truth: float | None = None
    moved_mm: float = 0.0
    across: float | None = None
    ambiguous: bool = False
    chance_fit: bool = False
    converged: bool = True
    free_directions: int = 0
    mirrored: bool = False


def diagnosis(evidence: Evidence) -> str:
    """One sentence, without a full stop."""
    start, end = evidence.start, evidence.end
    if start is None or end is None:
        return f"not registered: {evidence.reason}"
    if evidence.mirrored:
        return "one of the two sensors seems mirrored: their features agree only if one image is flipped left to right"
    if end.rotation_error_deg is None:
        return _without_truth(evidence, start, end)
    began = f"started {_how_right(evidence, start)} ({_start(evidence, start)})"
    if evidence.status == "ok":
        if worse_than_start(start, end):
            return f"{began} and ended worse, within the limits{_motion(evidence)}"
        return f"{began} and ended right"
    if _truth_is_doubtful(evidence, end):
        return (
            f"the given pose does not fit the images: overlap {evidence.overlap_truth:.2f} there and {end.overlap:.2f} "
            "here, where nothing speaks against; are the recording's poses, or its rig, right?"
        )
    if _is_right(evidence, start, NEARLY):
        where = "drifted" if evidence.across is None or evidence.across >= SLIDES else "slid along the surfaces"
        return _joined(f"{began}, then {where}, {evidence.moved_mm:.0f} mm", _why_it_left(start, end))
    if start.found_by == FEATURES:
        return _joined(f"the features agree on a wrong pose ({_start(evidence, start)})", _against(evidence, end))
    against = _against(evidence, end)
    if evidence.overlap_truth is not None and end.overlap >= evidence.overlap_truth - SAME_OVERLAP:
        little = "only " if evidence.overlap_truth < LITTLE_OVERLAP else ""
        equally = (
            f"overlap {little}{evidence.overlap_truth:.2f} at the truth, and this pose explains the clouds as well"
        )
        return _joined(equally, against)
    return _joined(f"started {_how_right(evidence, start)} ({_start(evidence, start)}) and was not brought in", against)


def _truth_is_doubtful(evidence: Evidence, end: Stage) -> bool:
    believed = evidence.converged and not (evidence.chance_fit or evidence.free_directions or _against(evidence, end))
    return believed and evidence.overlap_truth is not None and evidence.overlap_truth < end.overlap - TRUTH_LOST


def _without_truth(evidence: Evidence, start: Stage, end: Stage) -> str:
    against = _against(evidence, end)
    if evidence.free_directions:
        free = f"{evidence.free_directions} direction{'s' if evidence.free_directions > 1 else ''}"
        against.append(f"the shape leaves {free} free")
    if evidence.chance_fit:
        against.append("the clouds explain each other no better than by chance")
    if not evidence.converged:
        against.append("it had not come to rest")
    if start.found_by == FEATURES and evidence.status != "ok" and evidence.moved_mm > evidence.max_translation_mm:
        against.insert(
            0, f"it left the pose that {evidence.feature_inliers} features agree on by {evidence.moved_mm:.0f} mm"
        )
    if against:
        return "; ".join(against[:2])
    if evidence.status != "ok":
        return evidence.reason
    colors = "" if end.color_correlation is None else f", colours correlate by {end.color_correlation:.2f}"
    return f"nothing speaks against it: overlap {end.overlap:.2f}, {end.contradicted:.0%} contradicted{colors}"


def _against(evidence: Evidence, end: Stage) -> list[str]:
    """What speaks against the end, the strongest first."""
    found = end.contradictions()
    if evidence.agreeing_features is not None:
        left = left_behind(evidence.feature_inliers, evidence.agreeing_features)
        found = [left, *found] if left else found
    if evidence.ambiguous:
        found.append("two poses explain the clouds equally")
    if evidence.overlap_truth is None and end.overlap < LITTLE_OVERLAP:
        found.append(f"overlap only {end.overlap:.2f}")
    return found


def _why_it_left(start: Stage, end: Stage) -> list[str]:
    found = []
    before, after = start.color_correlation, end.color_correlation
    if before is not None and after is not None and after < before - COLORS_LOST:
        found.append(f"colour contradicts (correlation {after:.2f} instead of {before:.2f})")
    if end.overlap >= start.overlap - SAME_OVERLAP:
        found.append(f"the clouds meet as well there (overlap {end.overlap:.2f}, at the start {start.overlap:.2f})")
    return found


def _joined(sentence: str, clauses: list[str]) -> str:
    return "; ".join([sentence, *clauses[:2]])


def _motion(evidence: Evidence) -> str:
    along = evidence.across is not None and evidence.across < SLIDES
    return f": it slid {evidence.moved_mm:.0f} mm along the surfaces" if along else ""


def _start(evidence: Evidence, start: Stage) -> str:
    off = f"{start.rotation_error_deg:.1f}° and {start.translation_error_mm:.0f} mm off"
    if start.found_by != FEATURES:
        return f"from the clouds alone, {off}"
    return f"{evidence.feature_inliers} of {evidence.feature_matches} features agreed, {off}"


def _how_right(evidence: Evidence, start: Stage) -> str:
    if _is_right(evidence, start, 1.0):
        return "right"
    return "nearly right" if _is_right(evidence, start, NEARLY) else "off"


def _is_right(evidence: Evidence, stage: Stage, times: float) -> bool:
    return (
        stage.rotation_error_deg <= times * evidence.max_rotation_deg
        and stage.translation_error_mm <= times * evidence.max_translation_mm
    )
