"""Finished registrations on disk, one JSON line each, so that an interrupted run goes on where it was.

The first line says of what: {"format": "adagmm-edges", "version": 1, "of": {...}}; every other one is an edge. A last
line that was cut off is not there.
"""

import json
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.sequence.edges import Edge

FORMAT, VERSION = "adagmm-edges", 1


class EdgeFile:
    """The edges of one recording, found again by frame indices. `of` is what they depend on, as plain JSON data.

    Raises
    ------
    OutputError  if the file is there and of something else or damaged, or cannot be written.
    """

    def __init__(self, path: Path, of: dict) -> None:
        self.path = Path(path)
        header = json.dumps({"format": FORMAT, "version": VERSION, "of": of}, sort_keys=True)
        lines = self._lines()
        if lines and lines[0] != header:
            raise OutputError(
                f"{self.path}: holds registrations of another recording, or made otherwise; give another --output"
            )
        try:
            self.edges = [_edge(json.loads(line)) for line in lines[1:]]
        except (ValueError, KeyError, TypeError) as problem:
            raise OutputError(f"{self.path}: is damaged ({problem}); delete it to start anew") from problem
        self._found = {(edge.source, edge.target): edge for edge in self.edges}
        write_text(self.path, "\n".join([header, *lines[1:]]) + "\n")

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
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(json.dumps(values) + "\n")
        except OSError as problem:
            raise OutputError(f"{self.path}: cannot be written: {problem.strerror}") from problem
        self.edges.append(edge)
        self._found[edge.source, edge.target] = edge

    def _lines(self) -> list[str]:
        try:
            text = self.path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return []
        except (OSError, UnicodeDecodeError) as problem:
            raise OutputError(f"{self.path}: cannot be read: {problem}") from problem
        return text.split("\n")[:-1]  # what follows the last line's end was cut off


def _edge(values: dict) -> Edge:
    matrices = {
        key: None if values[key] is None else np.array(values[key], dtype=float)
        for key in ("transformation", "information")
    }
    return Edge(
        values["source"], values["target"], loop_closure=values["loop_closure"], reason=values["reason"], **matrices
    )
