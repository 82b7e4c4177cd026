"""The sections of `adagmm-bench pairs`: which pairs, which methods on them, and what is told of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from adagmm_bench.methods import METHODS
from adagmm_bench.pairs.consensus import judged_by_consensus
from adagmm_bench.pairs.lidar import LIDAR, find_lidar_pairs, lidar_tables
from adagmm_bench.pairs.made import TRUST
from adagmm_bench.pairs.overlap import ANYWHERE, OVERLAP, ROOMS, find_overlap_pairs
from adagmm_bench.pairs.problem import PairSource
from adagmm_bench.pairs.public import CLOUDS, find_public_pairs
from adagmm_bench.pairs.recorded import RECORDINGS, find_recorded_pairs
from adagmm_bench.pairs.tables import (
    ALL,
    by_group,
    curve_table,
    each_pair_table,
    error_table,
    found_table,
    short_name,
    trust_table,
)
from adagmm_bench.pairs.trust import WRONG_START, find_trust_pairs

CONSENSUS = "clouds, by consensus"
VIEWPOINTS = "adagmm-viewpoints"
Table = tuple[str, list[str], list[list]]  # title, columns, rows


class Finder(Protocol):
    def __call__(
        self, data_folder: Path | None, *, trials: int, seed: int
    ) -> tuple[Sequence[PairSource], Sequence[str]]: ...


@dataclass(frozen=True)
class Section:
    """Pairs of one kind.

    find : the pairs in a data folder, and a line for what is left out of them.
    wanted : whether a method is to run on a pair.
    tables : the tables of a section's records, with those of all sections.
    """

    title: str
    find: Finder
    wanted: Callable[[PairSource, str], bool]
    tables: Callable[[Sequence[dict], Sequence[dict]], list[Table]]


def methods_for(pair: PairSource, names: Sequence[str]) -> list[str]:
    """The methods to run on a pair: with the settings for dense clouds or scans where it is one of these, and told
    viewpoints only where they are known.
    """
    facts = pair.facts()
    if facts["section"] == LIDAR:
        return [f"{name}-lidar" if f"{name}-lidar" in METHODS else name for name in names if _for_lidar(pair, name)]
    dense = facts["section"] in (RECORDINGS, CLOUDS) or facts["group"].startswith(ROOMS)
    return [
        f"{name}-dense" if dense and f"{name}-dense" in METHODS else name
        for name in names
        if (name != VIEWPOINTS or facts.get("viewpoints")) and SECTIONS[facts["section"]].wanted(pair, name)
    ]


def judged(records: Sequence[dict], known: Sequence[dict]) -> tuple[list[dict], list[str]]:
    """The records, those of public pairs without a truth by the consensus or left out; and the notes that this needs.

    known : records of earlier runs too.
    """
    clouds = [record for record in records if record["problem"]["section"] == CLOUDS]
    told = [record for record in known if record["problem"]["section"] == CLOUDS]
    settled, left_out = judged_by_consensus(clouds, told, CONSENSUS)
    notes = []
    if any(record["problem"]["group"] == CONSENSUS for record in settled):
        notes.append(
            f"{CONSENSUS}: nobody measured the pose of these pairs; it is the one that most other libraries agree on, "
            "one of them without a start, so that they are judged by themselves there."
        )
    if left_out:
        notes.append(f"Left out, no truth and no consensus: {', '.join(left_out)}.")
    return [record for record in records if record["problem"]["section"] != CLOUDS] + settled, notes


def _found_and_errors(unit: str, scale: float) -> Callable[[Sequence[dict], Sequence[dict]], list[Table]]:
    """Tables with translations in `unit`, of which a unit of the records has `scale`."""

    def tables(records: Sequence[dict], everything: Sequence[dict]) -> list[Table]:
        methods = list(dict.fromkeys(record["method"] for record in records))
        groups = by_group(records)
        if not groups:
            return []
        return [
            (f"each pair, ° / {unit}, (not found), warned!", *each_pair_table(records, methods, scale)),
            ("found", *found_table(groups, methods)),
            ("errors, warnings and time", *error_table(groups[ALL], methods, unit, scale)),
        ]

    return tables


def _curves(records: Sequence[dict], everything: Sequence[dict]) -> list[Table]:
    return [("by the share of common points", *curve_table(records))] if records else []


def _lidar(records: Sequence[dict], everything: Sequence[dict]) -> list[Table]:
    columns, rows, drift_columns, drifts = lidar_tables(records, short_name)
    return [("errors", columns, rows), ("drift over the drive", drift_columns, drifts)] if rows else []


def _trust(records: Sequence[dict], everything: Sequence[dict]) -> list[Table]:
    """Over the pairs of this section; where others were run, the last row is over those of all."""
    methods = list(dict.fromkeys(record["method"] for record in records))
    cases, overall = by_group(records), by_group(everything)
    tables = []
    for method in methods:
        columns, rows = trust_table(cases, method)
        rows[-1][0] = "all of these"
        if len(everything) > len(records):
            whole = trust_table({ALL: overall[ALL]}, method)[1]
            rows.append(["all sections of this run", *whole[-1][1:]])
        tables.append((f"what {method} knows", columns, rows))
    return tables


def _for_lidar(pair: PairSource, name: str) -> bool:
    """Those that are set for scans, and ours."""
    return name == "adagmm" or f"{name}-lidar" in METHODS


def _any_method(pair: PairSource, name: str) -> bool:
    return True


def _by_start(pair: PairSource, name: str) -> bool:
    """From anywhere those that need no start, and ours; from nearby those that are started there."""
    anywhere = pair.facts()["group"].endswith(ANYWHERE)
    return METHODS[name].anywhere == anywhere or (anywhere and METHODS[name].ours)


def _ours(pair: PairSource, name: str) -> bool:
    """Those that warn; a wrong start is nothing to one that takes none."""
    return METHODS[name].ours and not (METHODS[name].anywhere and pair.facts().get("start") == WRONG_START)


def _public(data_folder: Path | None, *, trials: int, seed: int) -> tuple[Sequence[PairSource], Sequence[str]]:
    return find_public_pairs(data_folder), []


def _recorded(data_folder: Path | None, *, trials: int, seed: int) -> tuple[Sequence[PairSource], Sequence[str]]:
    return find_recorded_pairs(data_folder)


SECTIONS = {
    RECORDINGS: Section(
        "recorded pairs, geometry alone; found: within 5° and 0.2 m",
        _recorded,
        _any_method,
        _found_and_errors("mm", 1000.0),
    ),
    CLOUDS: Section(
        "public pairs; found: within 5° and a tenth of the RMS radius",
        _public,
        _any_method,
        _found_and_errors("% of r", 100.0),
    ),
    OVERLAP: Section(
        "pieces cut by planes; found: within 5° and a tenth of the RMS radius, in rooms 0.2 m",
        find_overlap_pairs,
        _by_start,
        _curves,
    ),
    LIDAR: Section("LiDAR scans, errors against their truth", find_lidar_pairs, _for_lidar, _lidar),
    TRUST: Section(
        "what shares nothing, what is easily mistaken, and misleading starts",
        find_trust_pairs,
        _ours,
        _trust,
    ),
}
