"""Finished registrations on disk, one JSON line each, so that an interrupted run goes on where it was.

The first line says of what: {"format": "adagmm-edges", "version": 3, "of": {...}}; every other one is an edge. An edge
without a pose gives way to a later one between the same frames. A last line that was cut off is not there. The file is
read as if somebody had written it who means no good.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import check_output_file, write_text
from adagmm_fusion.files.input_file import read_input_text
from adagmm_fusion.files.journal_lines import open_for_appending, sealed, unsealed
from adagmm_fusion.frames.rgbd import checked_rigid_transformation
from adagmm_fusion.sequence.edges import Edge
from adagmm_o3d.errors import InputError

FORMAT, VERSION = "adagmm-edges", 3
# Of an information matrix, as a share of its largest entry: what rounding leaves of symmetry and of no eigenvalue.
ROUNDING = 1e-9


class EdgeFile:
    """The edges of one recording, found again by frame indices.

    of : what they depend on, as plain JSON data: all of it, else a registration is taken for one that it is not.
    frames : how many frames there are, for their indices.

    Raises
    ------
    OutputError  if the file is there and of something else or damaged, or cannot be written.
    """

    def __init__(self, path: Path, of: dict[str, Any], frames: int) -> None:
        self.path = Path(path)
        check_output_file(self.path)
        lines = self._lines()
        if lines:
            self._check_header(lines[0], of)
        self._found: dict[tuple[int, int], Edge] = {}
        kept: dict[str, None] = {}
        for number, line in enumerate(lines[1:], 2):
            if line in kept:
                continue
            kept[line] = None
            try:
                edge = _edge(unsealed(line), frames)
                known = self.find(edge.source, edge.target)
                if known is not None and known.transformation is not None:
                    raise ValueError("these frames have an edge already")
            except (ValueError, KeyError, TypeError) as problem:
                raise self._damaged(number, problem) from problem
            self._keep(edge)
        write_text(self.path, "\n".join([sealed(_header(of)), *kept]) + "\n")

    @property
    def edges(self) -> list[Edge]:
        return list(self._found.values())

    def find(self, source: int, target: int) -> Edge | None:
        """The edge between two frames, if it was registered."""
        return self._found.get((source, target))

    def add(self, edge: Edge) -> None:
        """Append an edge to the file."""
        values = {
            "source": edge.source,
            "target": edge.target,
            "loop_closure": edge.loop_closure,
            "reason": edge.reason,
            "transformation": None if edge.transformation is None else edge.transformation.tolist(),
            "information": None if edge.information is None else edge.information.tolist(),
        }
        try:
            with os.fdopen(open_for_appending(self.path), "ab") as file:
                file.write(sealed(values).encode() + b"\n")
        except OSError as problem:
            raise OutputError(f"{self.path}: cannot be written: {problem.strerror}") from problem
        self._keep(edge)

    def _keep(self, edge: Edge) -> None:
        self._found[edge.source, edge.target] = edge

    def _lines(self) -> list[str]:
        if not self.path.exists():
            return []
        try:
            text = read_input_text(self.path, InputError)
        except InputError as problem:
            raise OutputError(str(problem)) from problem
        return text.split("\n")[:-1]  # what follows the last line's end was cut off

    def _check_header(self, line: str, of: dict[str, Any]) -> None:
        try:
            found, wanted = unsealed(line), _header(of)
        except ValueError as problem:
            raise self._damaged(1, problem) from problem
        if found == wanted:
            return
        was = found.get("of")
        other = [key for key in of if not isinstance(was, dict) or was.get(key) != of[key]]
        raise OutputError(
            f"{self.path}: holds registrations of another recording, or made otherwise (another "
            f"{', another '.join(other) or 'version of the file'}); delete it, or give another --output"
        )

    def _damaged(self, number: int, problem: Exception) -> OutputError:
        return OutputError(f"{self.path}:{number}: is damaged ({problem}); delete it to start anew")


def _header(of: dict[str, Any]) -> dict[str, Any]:
    return {"format": FORMAT, "version": VERSION, "of": of}


def _edge(values: dict[str, Any], frames: int) -> Edge:
    """The edge of a record. Raises ValueError, KeyError or TypeError if it is none between so many frames."""
    source, target, loop_closure, reason = (values[key] for key in ("source", "target", "loop_closure", "reason"))
    for index in (source, target):
        if type(index) is not int or not 0 <= index < frames:
            raise ValueError(f"expected frames from 0 to {frames - 1}, got {index!r}")
    if type(loop_closure) is not bool or not isinstance(reason, str):
        raise ValueError("expected loop_closure true or false and reason a text")
    if reason and values["transformation"] is None and values["information"] is None:
        return Edge(source, target, None, None, loop_closure, reason)
    T = checked_rigid_transformation(values["transformation"], "transformation")
    return Edge(source, target, T, _information(values["information"]), loop_closure, reason)


def _information(values: Any) -> np.ndarray:
    information = np.array(values, dtype=np.float64)
    if information.shape != (6, 6) or not np.isfinite(information).all():
        raise ValueError("information: expected (6, 6) finite numbers")
    rounding = ROUNDING * np.abs(information).max()
    if np.abs(information - information.T).max() > rounding or np.linalg.eigvalsh(information)[0] < -rounding:
        raise ValueError("information: expected a symmetric matrix without negative eigenvalues")
    return information
