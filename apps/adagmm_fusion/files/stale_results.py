"""What an earlier run has left in a folder of results: it goes before the next one writes there."""

import json
import re
from collections.abc import Iterable
from pathlib import Path

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.input_file import read_input_text
from adagmm_o3d.errors import AdaGMMError, InputError

# What a run may have written, relative to its folder. A report that names anything else is not believed.
RESULT = re.compile(r"(fused/[^/\\]+\.(ply|glb)|rig\.yaml|[^/\\]+\.rrd)")


def remove_results_of_report(folder: Path, schema: str) -> None:
    """Remove report.json, report.md and the results that it names, where an earlier run with this schema left them.

    Raises
    ------
    OutputError  if one cannot be removed.
    """
    try:
        content = json.loads(read_input_text(folder / "report.json", InputError))
        named = content["results"].values() if content["schema"] == schema else ()
    except (AdaGMMError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return
    names = [name for name in named if isinstance(name, str) and RESULT.fullmatch(name) and name.isprintable()]
    remove_files(folder, [*names, "report.json", "report.md"])


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
