"""Pairs summed up: found, wrong without a warning, right with one, errors, and processor time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from adagmm_bench.methods import METHODS

ALL = "all"


@dataclass(frozen=True)
class PairSummary:
    """One method on some pairs. Silently wrong and false alarms: None for methods that do not warn. Errors: medians
    over all pairs with a truth, and over those that were found (None without any). Overlap: among the found, the median
    difference from the truth's own.
    """

    method: str
    trials: int
    found: int
    failed: int
    silently_wrong: int | None
    false_alarms: int | None
    rotation_deg: float | None
    translation: float | None
    rotation_deg_found: float | None
    translation_found: float | None
    overlap_off: float | None
    cpu_seconds_median: float
    pose_cpu_seconds_median: float
    cpu_seconds_total: float

    @property
    def cell(self) -> str:
        """Found, and in brackets what was wrong without a warning."""
        silent = "" if self.silently_wrong is None else f" ({self.silently_wrong})"
        return f"{self.found}{silent}"

    def as_dict(self) -> dict:
        return asdict(self)


def is_found(record: dict) -> bool:
    """Whether there is a right pose and this is within the record's limits of it."""
    if record["status"] != "ok" or record["rotation_error_deg"] is None:
        return False
    degrees, displacement = record["limits"]
    return record["rotation_error_deg"] < degrees and record["translation_error"] < displacement


def pose_cpu_seconds(record: dict) -> float:
    """Until the pose was there; peers say nothing more."""
    return record.get("pose_cpu_seconds", record["cpu_seconds"])


def summarise_pairs(method: str, records: Sequence[dict]) -> PairSummary:
    """The records of one method, at least one."""
    found = [is_found(record) for record in records]
    right = [record for record, ok in zip(records, found, strict=True) if ok]
    warns = METHODS[method].ours
    # A call that raised has said so.
    warned = [record["status"] != "ok" or bool(record.get("warnings")) for record in records]
    off = [
        abs(record["overlap"] - record["overlap_truth"])
        for record in right
        if record.get("overlap") is not None and record.get("overlap_truth") is not None
    ]

    def median(members: Sequence[dict], name: str) -> float | None:
        values = [record[name] for record in members if record[name] is not None]
        return float(np.median(values)) if values else None

    return PairSummary(
        method=method,
        trials=len(records),
        found=len(right),
        failed=sum(record["status"] != "ok" for record in records),
        silently_wrong=sum(not f and not w for f, w in zip(found, warned, strict=True)) if warns else None,
        false_alarms=sum(f and w for f, w in zip(found, warned, strict=True)) if warns else None,
        rotation_deg=median(records, "rotation_error_deg"),
        translation=median(records, "translation_error"),
        rotation_deg_found=median(right, "rotation_error_deg"),
        translation_found=median(right, "translation_error"),
        overlap_off=float(np.median(off)) if off else None,
        cpu_seconds_median=float(np.median([record["cpu_seconds"] for record in records])),
        pose_cpu_seconds_median=float(np.median([pose_cpu_seconds(record) for record in records])),
        cpu_seconds_total=float(sum(record["cpu_seconds"] for record in records)),
    )


def by_group(records: Sequence[dict]) -> dict[str, dict[str, PairSummary]]:
    """Group -> method -> summary, in the order of the records, and over all of them under ALL."""
    groups: dict[str, dict[str, list[dict]]] = {}
    for record in records:
        for group in (record["problem"]["group"], ALL):
            groups.setdefault(group, {}).setdefault(record["method"], []).append(record)
    if records:
        groups[ALL] = groups.pop(ALL)
    return {
        group: {method: summarise_pairs(method, members) for method, members in methods.items()}
        for group, methods in groups.items()
    }


def found_table(groups: dict[str, dict[str, PairSummary]], methods: Sequence[str]) -> tuple[list[str], list[list]]:
    """A row for each group, a column for each method."""
    rows = []
    for group, members in groups.items():
        trials = max(summary.trials for summary in members.values())
        cells = [members[method].cell if method in members else "" for method in methods]
        rows.append([f"{group}, {trials}", *cells])
    return ["found (silently wrong)", *map(short_name, methods)], rows


def error_table(
    summaries: dict[str, PairSummary], methods: Sequence[str], unit: str, scale: float
) -> tuple[list[str], list[list]]:
    """A row for each method; translations in `unit`, of which a unit of the records has `scale`."""
    columns = [
        "method",
        "found",
        "silently wrong",
        "false alarms",
        "gave up",
        "median °",
        f"median {unit}",
        "of found °",
        f"of found {unit}",
        "overlap off",
        "CPU s",
        "of the pose",
    ]

    def shown(value: float | None, form: str = "{}", times: float = 1.0) -> str:
        return "-" if value is None else form.format(value if times == 1.0 else times * value)

    rows = []
    for s in (summaries[method] for method in methods if method in summaries):
        rows.append(
            [
                short_name(s.method),
                f"{s.found}/{s.trials}",
                shown(s.silently_wrong),
                shown(s.false_alarms),
                s.failed,
                shown(s.rotation_deg, "{:.2f}"),
                shown(s.translation, "{:.1f}", scale),
                shown(s.rotation_deg_found, "{:.2f}"),
                shown(s.translation_found, "{:.1f}", scale),
                shown(s.overlap_off, "{:.2f}"),
                f"{s.cpu_seconds_median:.2f}",
                f"{s.pose_cpu_seconds_median:.2f}",
            ]
        )
    return columns, rows


def short_name(method: str) -> str:
    """The name that all settings of a method share."""
    return method.removesuffix("-dense").removesuffix("-lidar")


def each_pair_table(records: Sequence[dict], methods: Sequence[str], scale: float) -> tuple[list[str], list[list]]:
    """A row for each pair, a column for each method: degrees / translation, in brackets where that was not found, with
    an exclamation mark where the method warned; a dash where it gave up.
    """
    pairs: dict[str, dict[str, str]] = {}
    for record in records:
        cell = "-"
        if record["status"] == "ok":
            cell = f"{record['rotation_error_deg']:.2f} / {scale * record['translation_error']:.1f}"
            cell = (cell if is_found(record) else f"({cell})") + ("!" if record.get("warnings") else "")
        pairs.setdefault(record["problem"]["pair"], {})[record["method"]] = cell
    rows = [[pair, *(cells.get(method, "") for method in methods)] for pair, cells in pairs.items()]
    return ["pair", *map(short_name, methods)], rows


def curve_table(records: Sequence[dict]) -> tuple[list[str], list[list]]:
    """A row for each group and method, a column for each share of common points, the largest first."""
    shares = sorted({record["problem"]["share"] for record in records}, reverse=True)
    members: dict[tuple[str, str], dict[float, list[dict]]] = {}
    for record in records:
        row = members.setdefault((record["problem"]["group"], record["method"]), {})
        row.setdefault(record["problem"]["share"], []).append(record)
    rows = []
    for (group, method), by_share in members.items():
        trials = max(map(len, by_share.values()))
        cells = [summarise_pairs(method, by_share[share]).cell if share in by_share else "" for share in shares]
        rows.append([f"{group}, {trials}: {short_name(method)}", *cells])
    return ["found (silently wrong)", *(f"{share:.0%}" for share in shares)], rows


def trust_table(groups: dict[str, dict[str, PairSummary]], method: str) -> tuple[list[str], list[list]]:
    """A row for each group in which one of our methods took part; the last are all of them, in per cent too."""
    rows = []
    for group, members in groups.items():
        if method not in members:
            continue
        s = members[method]
        counts = [s.silently_wrong, s.false_alarms]
        if group == ALL:
            counts = [f"{count} ({count / s.trials:.1%})" for count in counts]
        rows.append([group, s.trials, s.found, *counts])
    return [method, "pairs", "right", "silently wrong", "false alarms"], rows
