"""What an earlier run has left in a folder of results: it goes once the next one has written its own there."""

import json
import os
import re
import stat
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.input_file import read_input_text
from adagmm_o3d.errors import AdaGMMError, InputError

# What a run may have written, relative to its folder. A report that names anything else is not believed.
RESULT = re.compile(r"(fused/[^/\\]+\.(ply|glb)|rig\.yaml|[^/\\]+\.rrd)")
# The report itself; by the first a later run knows the second for its own.
REPORTS = ("report.json", "report.md")
# What reports of this program call themselves: of one recording, and of several.
SCHEMA, JOINT_SCHEMA = "adagmm-fusion-report", "adagmm-fusion-joint-report"
# By what its first bytes hold, a file is known for one of ours, though a run was killed before it wrote its report.
MARKS = {
    ".ply": b"\ncomment adagmm-fusion\n",
    ".glb": b'"generator": "adagmm-fusion"',
    ".obj": b"# adagmm-fusion\n",
    ".mtl": b"# adagmm-fusion\n",
    ".rrd": b"adagmm_fusion",
    ".txt": b"# timestamp tx ty tz qx qy qz qw, camera to world, metres\n",
}
MARKED_WITHIN = 256


def results_of_report(folder: Path) -> list[str]:
    """report.json, report.md and the results that it names, where an earlier run left them."""
    try:
        content = json.loads(read_input_text(folder / "report.json", InputError))
        if content["schema"] not in (SCHEMA, JOINT_SCHEMA):
            return []
        named = content.get("results", {}).values()
    except (AdaGMMError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return []
    names = [name for name in named if isinstance(name, str) and RESULT.fullmatch(name) and name.isprintable()]
    return [*names, *REPORTS]


def check_not_foreign(folder: Path, names: Iterable[str], of_earlier: Collection[str]) -> None:
    """Before the work: raise OutputError where a file that is to be written is there and is not of an earlier run."""
    for name in names:
        if name not in of_earlier and os.path.lexists(folder / name) and not is_marked(folder / name):
            raise OutputError(
                f"{folder / name}: is there already, and no earlier run has left it; move it, or give another --output"
            )


def is_marked(path: Path) -> bool:
    """Whether a file says itself that this program has written it, as clouds, meshes, ways and Rerun recordings do."""
    mark = MARKS.get(path.suffix)
    try:
        if mark is None or not stat.S_ISREG(path.lstat().st_mode):
            return False
        with path.open("rb") as file:
            return mark in file.read(MARKED_WITHIN)
    except OSError:
        return False


def states_of(folder: Path, names: Iterable[str]) -> dict[str, tuple[int, int] | None]:
    """What tells each of these files from one that replaces it; None where there is none."""
    states: dict[str, tuple[int, int] | None] = {}
    for name in names:
        try:
            status = (folder / name).lstat()
            states[name] = status.st_ino, status.st_mtime_ns
        except OSError:
            states[name] = None
    return states


def remove_untouched(folder: Path, earlier: Mapping[str, tuple[int, int] | None]) -> None:
    """Remove the files that are as `states_of` found them. Raises OutputError if it fails."""
    now = states_of(folder, earlier)
    remove_files(folder, [name for name, state in earlier.items() if now[name] == state])


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Remove these files of a folder, regular ones that are not below a link. Raises OutputError if it fails."""
    for name in names:
        path = folder / name
        try:
            if path.is_file() and not path.is_symlink() and not path.parent.is_symlink():
                path.unlink()
        except OSError as problem:
            raise OutputError(
                f"{path}: of an earlier run, cannot be removed: {problem.strerror}; give another --output"
            ) from problem
