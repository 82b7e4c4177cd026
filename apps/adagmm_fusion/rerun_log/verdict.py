"""What a person reads first: did it work, how far off is it, and if not, why. Markdown for the report view."""

from dataclasses import dataclass

import numpy as np

from adagmm_fusion.rerun_log.diagnostics import CONTRADICTED, PARTNER, PointDiagnostics
from adagmm_fusion.rerun_log.iterations import pose_errors
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
    T_truth: np.ndarray | None,
    diagnostics: PointDiagnostics | None = None,
    limits: Limits = DEFAULT_LIMITS,
    *,
    status: str = "",
    reason: str = "",
    seconds: float | None = None,
) -> str:
    """The report of one pair: the verdict, a table of before, after and limit, and what the estimate says of itself."""
    lines = [f"# {verdict(estimate, T_truth, limits, status, reason)}", "", f"**{name}**", ""]
    if estimate is None:
        return "\n".join(lines)
    lines += ["| | before | after | limit |", "|:--|--:|--:|--:|"]
    if T_truth is not None:
        ends = np.stack([estimate.transformations[0], estimate.transformation])
        angles_deg, distances_mm = pose_errors(ends, T_truth)
        lines += [
            f"| rotation error [°] | {angles_deg[0]:.2f} | **{angles_deg[1]:.2f}** | {limits.rotation_deg:g} |",
            f"| translation error [mm] | {distances_mm[0]:.0f} | **{distances_mm[1]:.0f}** | "
            f"{limits.translation_mm:g} |",
        ]
    else:
        lines += ["| *no ground truth* | | | |"]
    lines += [f"| overlap, as estimated [%] | | {100.0 * estimate.overlap:.0f} | |"]
    if diagnostics is not None:
        partners, contradicted = (100.0 * np.mean(diagnostics.overlap == state) for state in (PARTNER, CONTRADICTED))
        lines += [
            f"| overlap, within {1000.0 * diagnostics.partner_distance:.0f} mm [%] | | {partners:.0f} | |",
            f"| contradicted by the target's depth [%] | | {contradicted:.0f} | |",
        ]
    if len(estimate.sigmas):
        lines += [f"| σ [mm²] | {1e6 * estimate.sigmas[0]:.3g} | {1e6 * estimate.sigmas[-1]:.3g} | |"]
    lines += ["", f"{estimate.iterations} EM iterations, stopped: {estimate.stop_reason}."]
    if seconds is not None:
        lines += [f"{seconds:.2f} s."]
    if estimate.unobservable:
        lines += ["", f"**{len(estimate.unobservable)} direction(s) not determined by the clouds**: see the arrows."]
    lines += ["", *(f"- **Warning:** {warning}" for warning in estimate.warnings)]
    return "\n".join(lines)


def verdict(
    estimate: PointRegistrationResult | None,
    T_truth: np.ndarray | None,
    limits: Limits,
    status: str = "",
    reason: str = "",
) -> str:
    """One line; the caller's own status and reason go before what the errors say."""
    if estimate is None or status == "failed":
        return f"× Failed{f': {reason}' if reason else ''}"
    if T_truth is None:
        return "? Registered, no ground truth to compare with"
    angle_deg, distance_mm = (float(e[0]) for e in pose_errors(estimate.transformation[None], T_truth))
    if angle_deg <= limits.rotation_deg and distance_mm <= limits.translation_mm:
        return f"✔ Registered: {angle_deg:.2f}° and {distance_mm:.0f} mm off"
    return f"× Failed: {angle_deg:.2f}° and {distance_mm:.0f} mm off"
