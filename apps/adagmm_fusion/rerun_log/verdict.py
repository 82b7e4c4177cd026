"""What a person reads first: did it work, how far off is it, and if not, why. Markdown for the report view."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from adagmm_fusion.files.markdown import plain
from adagmm_fusion.pairs.point_diagnostics import CONTRADICTED, HIDDEN, PARTNER, PointDiagnostics
from adagmm_fusion.pairs.spread import spread_mm
from adagmm_fusion.pairs.stages import END, Stage, worse_than_start
from adagmm_o3d.result import PointRegistrationResult


@dataclass(frozen=True)
class Limits:
    """Errors up to which a registration counts as right."""

    rotation_deg: float = 5.0
    translation_mm: float = 100.0


DEFAULT_LIMITS = Limits()


def pair_report(
    name: str,
    estimate: PointRegistrationResult | None,
    stages: Sequence[Stage],
    diagnostics: PointDiagnostics | None = None,
    limits: Limits = DEFAULT_LIMITS,
    *,
    status: str = "",
    reason: str = "",
    diagnosis: str = "",
    variance: float | None = None,
    seconds: float | None = None,
) -> str:
    """The report of one pair: the verdict, why, the errors of every stage, and what the estimate says of itself.

    Its tables are narrow: they are read beside the pictures, in small windows too.
    """
    lines = [f"### {verdict(estimate, stages, limits, status, plain(reason))}", ""]
    if diagnosis:
        lines += [f"**Why:** {diagnosis}.", ""]
    if estimate is None:
        return "\n".join([*lines, plain(name)])
    if any(stage.rotation_error_deg is not None for stage in stages):
        lines += ["| error | ° | mm |", "|:--|--:|--:|"]
        lines += [_stage_row(stage, stages) for stage in stages]
        lines += [f"| limit | {limits.rotation_deg:g} | {limits.translation_mm:g} |", ""]
    else:
        lines += ["*No ground truth.*", ""]
    lines += [f"| of the source | {END} | of all stages |", "|:--|--:|--:|"]
    if diagnostics is not None:
        within = f"overlap, within {1000.0 * diagnostics.partner_distance:.0f} mm"
        for text, state, attribute in (
            (within, PARTNER, "overlap"),
            ("contradicted", CONTRADICTED, "contradicted"),
            ("out of sight", HIDDEN, ""),
        ):
            shares = " → ".join(f"{100.0 * getattr(stage, attribute):.0f}" for stage in stages if attribute)
            lines.append(f"| {text} | {100.0 * np.mean(diagnostics.overlap == state):.0f} % | {shares} |")
    lines.append(f"| partners it believes in | {100.0 * estimate.overlap:.0f} % | |")
    if any(stage.color_correlation is not None for stage in stages):
        known = [stage.color_correlation for stage in stages]
        shares = " → ".join("–" if value is None else f"{value:.2f}" for value in known)
        last = "–" if known[-1] is None else f"{known[-1]:.2f}"
        lines.append(f"| colours correlate | {last} | {shares} |")
    spread = ""
    if len(estimate.sigmas) and variance is not None:
        first, last = spread_mm(np.asarray(estimate.sigmas)[[0, -1]], variance)
        spread = f", spread of the points {first:.0f} → {last:.0f} mm"
    lines += ["", f"{estimate.iterations} EM iterations{spread}, stopped: {estimate.stop_reason}."]
    if seconds is not None:
        lines += [f"{seconds:.2f} s."]
    if estimate.unobservable:
        free = len(estimate.unobservable)
        lines += ["", f"**{free} direction{'s' * (free > 1)} not determined by the clouds**: see the arrows."]
    lines += ["", *(f"- **Warning:** {warning}" for warning in estimate.warnings), "", plain(name)]
    return "\n".join(lines)


def verdict(
    estimate: PointRegistrationResult | None,
    stages: Sequence[Stage],
    limits: Limits,
    status: str = "",
    reason: str = "",
) -> str:
    """One line; the caller's own status goes before what the errors say, its reason stands where there are none."""
    end = stages[-1] if stages else None
    if estimate is None or end is None or end.rotation_error_deg is None or end.translation_error_mm is None:
        if estimate is None or status == "failed":
            return f"× Failed{f': {reason}' if reason else ''}"
        return "? Registered, no ground truth to compare with"
    off = f"{end.rotation_error_deg:.2f}° and {end.translation_error_mm:.0f} mm off"
    if (
        status == "failed"
        or end.rotation_error_deg > limits.rotation_deg
        or end.translation_error_mm > limits.translation_mm
    ):
        return f"× Failed: {off}"
    return f"✔ Registered: {off}" + (", worse than its start" if worse_than_start(stages[1], end) else "")


def _stage_row(stage: Stage, stages: Sequence[Stage]) -> str:
    numbers = f"{stage.rotation_error_deg:.2f} | {stage.translation_error_mm:.0f}"
    if stage.stage != END:
        return f"| {stage.title} | {numbers} |"
    angle, distance = numbers.split(" | ")
    worse = " ▲ worse" if worse_than_start(stages[1], stage) else ""
    return f"| **{stage.title}**{worse} | **{angle}** | **{distance}** |"
