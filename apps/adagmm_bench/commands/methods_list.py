"""`methods`: what there is to compare, how it is set, and why some of it cannot run here."""

from __future__ import annotations

import argparse

from adagmm_bench.methods import METHODS
from adagmm_bench.methods.registry import UNUSABLE
from adagmm_fusion.processes.terminal import printable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """It takes none."""


def run(arguments: argparse.Namespace) -> int:
    for entry in METHODS.values():
        where = "/".join(f"{dimension}D" for dimension in entry.dimensions)
        state = entry.version() if (missing := entry.missing()) is None else f"cannot run: {missing}"
        named = "" if entry.default else ", only where named"
        print(f"{entry.name} [{where}{named}] {state}\n    {entry.settings()}")
    for reason in UNUSABLE.values():
        print(printable(reason))
    return 0
