"""What other packages add by entry points, by name; nothing of theirs is imported before it is asked for."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from typing import Any

from adagmm_o3d.errors import InputError

EntryPoints = Mapping[str, importlib.metadata.EntryPoint]


def entry_points(group: str, ours: tuple[str, ...] = ()) -> EntryPoints:
    """The entry points of a group, by name.

    Raises
    ------
    InputError : two have one name, or one of them has the name of one of `ours`.
    """
    found: dict[str, importlib.metadata.EntryPoint] = {}
    for entry in importlib.metadata.entry_points(group=group):
        if entry.name in ours or (entry.name in found and found[entry.name].value != entry.value):
            others = "adagmm_o3d" if entry.name in ours else _origin(found[entry.name])
            raise InputError(
                f"entry point {entry.name!r} of {group}: expected a name of its own, but {_origin(entry)} and {others} "
                "have it; uninstall one"
            )
        found[entry.name] = entry
    return found


def load(entry: importlib.metadata.EntryPoint) -> Any:
    """What an entry point names.

    Raises
    ------
    InputError : it cannot be imported.
    """
    try:
        return entry.load()
    except Exception as error:  # somebody else's module may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(
            f"entry point {entry.name!r} of {entry.group}: {entry.value} of {_origin(entry)} cannot be used ({reason})"
        ) from error


def _origin(entry: importlib.metadata.EntryPoint) -> str:
    return "an unknown package" if entry.dist is None else entry.dist.name
