"""Trials summed up: per method and start over everything, over a sweep, and per setting of a sweep."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass

import numpy as np

FOUND_ROTATION_ERROR = 0.1  # simulations: ‖I − R_gt R⁻¹‖_F, about 4 degrees


@dataclass(frozen=True)
class Summary:
    """Trials of one method from one start. Rotation error ‖I − R_gt R⁻¹‖_F; a failed trial counts with its start's
    errors.
    """

    method: str
    start: str
    trials: int
    found: int
    failed: int
    mean: float
    std: float
    median: float
    translation_mean: float
    translation_median: float
    rotation_deg_median: float
    overlap_mean: float
    seconds_median: float
    seconds_total: float
    cpu_seconds_total: float

    @property
    def label(self) -> str:
        return f"{self.method} ({self.start})"

    def as_dict(self) -> dict:
        return asdict(self)


def found_in_simulation(record: Mapping) -> bool:
    """Whether the rotation is within 0.1 of the truth's."""
    return record["rotation_error"] <= FOUND_ROTATION_ERROR


def summarise(records: Iterable[Mapping], is_found: Callable[[Mapping], bool] = found_in_simulation) -> list[Summary]:
    """One summary for each method and start, best mean rotation error first."""
    groups: dict[tuple[str, str], list[Mapping]] = {}
    for record in records:
        groups.setdefault((record["method"], record["start"]), []).append(record)
    summaries = [_summary(method, start, group, is_found) for (method, start), group in groups.items()]
    return sorted(summaries, key=lambda summary: (summary.mean, summary.label))


def _summary(method: str, start: str, records: list[Mapping], is_found: Callable[[Mapping], bool]) -> Summary:
    def values(name: str) -> np.ndarray:
        return np.array([record[name] for record in records])

    rotation, translation = values("rotation_error"), values("translation_error")
    return Summary(
        method=method,
        start=start,
        trials=len(records),
        found=sum(map(is_found, records)),
        failed=sum(record["status"] != "ok" for record in records),
        mean=float(rotation.mean()),
        std=float(rotation.std()),
        median=float(np.median(rotation)),
        translation_mean=float(translation.mean()),
        translation_median=float(np.median(translation)),
        rotation_deg_median=float(np.median(values("rotation_error_deg"))),
        overlap_mean=float(values("overlap").mean()),
        seconds_median=float(np.median(values("seconds"))),
        seconds_total=float(values("seconds").sum()),
        cpu_seconds_total=float(values("cpu_seconds").sum()),
    )


def by_setting(records: Iterable[Mapping], sweep: str) -> dict[tuple[str, str], dict[float, tuple[float, float]]]:
    """For each method and start: setting -> mean and standard deviation of the rotation error."""
    errors: dict[tuple[str, str], dict[float, list[float]]] = {}
    for record in records:
        if record["problem"]["sweep"] == sweep:
            settings = errors.setdefault((record["method"], record["start"]), {})
            settings.setdefault(record["problem"]["setting"], []).append(record["rotation_error"])
    return {
        label: {setting: (float(np.mean(e)), float(np.std(e))) for setting, e in sorted(settings.items())}
        for label, settings in errors.items()
    }


def best_start(summaries: Iterable[Summary]) -> list[Summary]:
    """Each method's best start only, in the order given (best mean first)."""
    seen: dict[str, Summary] = {}
    for summary in summaries:
        seen.setdefault(summary.method, summary)
    return list(seen.values())
