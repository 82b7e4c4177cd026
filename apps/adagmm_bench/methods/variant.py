"""Ways to run `register_points`: by its options, or with constants and functions of the package replaced."""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from adagmm_o3d.errors import InputError


@dataclass(frozen=True)
class Replacement:
    """What stands in for a name of a module of adagmm_o3d. A name that was imported is replaced where it is read.

    name : of a constant, a function or, as "Class.method", a method.
    """

    module: str
    name: str
    value: Any

    def place(self) -> tuple[Any, str]:
        """The module or class that the name stands in, and its last part.

        Raises
        ------
        InputError  if the package has no such name any more.
        """
        *classes, last = self.name.split(".")
        place = importlib.import_module(f"adagmm_o3d.{self.module}")
        for name in classes:
            place = getattr(place, name, None)
        if last not in getattr(place, "__dict__", {}):
            raise InputError(f"adagmm_o3d.{self.module}: expected a name {self.name} to replace, found none")
        return place, last


@contextmanager
def replaced(replacements: Sequence[Replacement]) -> Iterator[None]:
    """Have the replacements in place, in this process, until the block ends."""
    places = [replacement.place() for replacement in replacements]
    originals = [vars(place)[name] for place, name in places]
    try:
        for (place, name), replacement in zip(places, replacements, strict=True):
            setattr(place, name, replacement.value)
        yield
    finally:
        for (place, name), original in zip(places, originals, strict=True):
            setattr(place, name, original)


@dataclass(frozen=True)
class Variant:
    """`register_points` under one name: its options and start, whether it is told the viewpoints, and what is replaced
    in the package while it runs; `meaning` is what the reports say about it."""

    meaning: str
    options: dict[str, Any] = field(default_factory=dict)
    init: str | None = None
    viewpoints: bool = False
    replacements: tuple[Replacement, ...] = ()
