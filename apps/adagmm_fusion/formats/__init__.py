"""The recording formats, one file each.

A format is a module with `NAME` (what --format takes), `SUMMARY` (one line), `matches(path) -> bool` (cheap: looks at
names, and at a small text where these do not tell) and `read(path, options) -> Recording` (strict; images are loaded
later). It is listed in MODULES, and that is all. Another package adds one by an entry point of the group
`adagmm_fusion.formats` that names such a module.
"""

import importlib
import logging
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType

from adagmm_o3d.entry_points import entry_points, load
from adagmm_o3d.errors import InputError

_log = logging.getLogger("adagmm_fusion")

GROUP = "adagmm_fusion.formats"
# Each format's NAME and module here.
MODULES = {
    "adagmm": "own",
    "tum": "tum",
    "redwood": "redwood",
    "7scenes": "seven_scenes",
    "posefile": "pose_file",
    "apc": "apc",
    "xtion": "xtion",
    "scannet": "scannet",
    "sens": "scannet_sens",
    "icl-nuim": "icl_nuim",
    "bop": "bop",
    "replica": "replica",
    "nerfstudio": "nerfstudio",
    "stray": "stray_scanner",
    "polycam": "polycam",
    "scanner-app": "scanner_app",
    "record3d": "record3d",
    "video": "video",
    "rosbag": "ros_bag",
    "folder": "folder",
}
# What takes any folder is asked only where no other format knows it.
FALLBACK = "folder"


class Formats(Mapping[str, ModuleType]):
    """The formats by name, ours first; each is imported when it is asked for."""

    def __getitem__(self, name: str) -> ModuleType:
        """Raises KeyError for an unknown name, InputError where another package's module cannot be used."""
        if name in MODULES:
            return importlib.import_module(f"adagmm_fusion.formats.{MODULES[name]}")
        module = load(entry_points(GROUP, tuple(MODULES))[name])
        if missing := [part for part in ("SUMMARY", "matches", "read") if not hasattr(module, part)]:
            raise InputError(f"format {name!r}: expected {module.__name__} to have {' and '.join(missing)}")
        return module

    def __iter__(self) -> Iterator[str]:
        return iter((*MODULES, *entry_points(GROUP, tuple(MODULES))))

    def __len__(self) -> int:
        return sum(1 for _ in self)


FORMATS = Formats()


def matching(path: Path) -> list[str]:
    """The formats that take a path for theirs, FALLBACK where no other does; one of another package's that fails is
    passed over and said."""
    names = [name for name in MODULES if name != FALLBACK and FORMATS[name].matches(path)]
    for name in list(FORMATS)[len(MODULES) :]:
        try:
            if FORMATS[name].matches(path):
                names.append(name)
        except Exception as error:
            _say_once(name, " ".join(str(error).split()))
    if not names and FORMATS[FALLBACK].matches(path):
        names.append(FALLBACK)
    return names


@cache
def _say_once(name: str, problem: str) -> None:
    _log.warning("format %r is not looked for: %s", name, problem)
