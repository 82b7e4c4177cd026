"""The numbers in a file of OpenCV's FileStorage, read by a process of its own.

On some damaged files OpenCV does not raise an error but ends the process. The child prints what it found as JSON:

    python -m adagmm_fusion.files.opencv_nodes FILE NAME...
"""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

TIMEOUT_S = 60
MEMORY_BYTES = 2 << 30
MAX_NUMBERS = 1000  # of one matrix or list; a calibration has a dozen


@dataclass(frozen=True, eq=False)
class OpenCVNodes:
    """`numbers`: the wanted top-level numbers, lists and matrices by their plain name. `keys`: all top-level names.
    `scalars`, `texts`: all single numbers and texts among them, by their plain name."""

    numbers: dict[str, np.ndarray]
    keys: tuple[str, ...]
    scalars: dict[str, float]
    texts: dict[str, str]

    def first(self, names: tuple[str, ...]) -> np.ndarray | None:
        """The numbers under the first of these names that is there, or None."""
        return next((self.numbers[name] for name in names if name in self.numbers), None)


def plain_name(key: str) -> str:
    """A key without case and underscores, which programs write as they please."""
    return key.lower().replace("_", "")


def read_nodes(path: Path, names: tuple[str, ...]) -> OpenCVNodes | None:
    """The top-level nodes of these plain names; None if the file is none of OpenCV's, or one of them has no numbers."""
    command = [sys.executable, "-m", "adagmm_fusion.files.opencv_nodes", str(path), *names]
    try:
        done = subprocess.run(command, capture_output=True, timeout=TIMEOUT_S, check=True)
        found = json.loads(done.stdout)
        numbers = {name: np.array(values, dtype=float) for name, values in found["numbers"].items()}
    except (subprocess.SubprocessError, ValueError):
        return None
    return OpenCVNodes(numbers, tuple(found["keys"]), found["scalars"], found["texts"])


def _numbers(node: cv2.FileNode) -> list | float:
    if node.isMap():
        if any(node.getNode(key).real() > MAX_NUMBERS for key in ("rows", "cols")):
            raise ValueError("a matrix that is too large")
        return node.mat().tolist()
    if node.isSeq():
        return [_numbers(node.at(i)) for i in range(min(node.size(), MAX_NUMBERS))]
    if not (node.isInt() or node.isReal()):  # OpenCV gives 1.8e308 for a text
        raise ValueError("no number")
    return node.real()


def _main(path: str, *names: str) -> None:
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    except ImportError:
        pass  # not on Windows
    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
    if not storage.isOpened():
        raise ValueError("OpenCV cannot read it")
    root = storage.root()
    wanted = {plain_name(key): key for key in root.keys() if plain_name(key) in names}  # noqa: SIM118
    numbers = {name: _numbers(root.getNode(key)) for name, key in wanted.items()}
    nodes = {plain_name(key): root.getNode(key) for key in root.keys()}  # noqa: SIM118
    scalars = {name: node.real() for name, node in nodes.items() if node.isInt() or node.isReal()}
    texts = {name: node.string() for name, node in nodes.items() if node.isString()}
    print(json.dumps({"numbers": numbers, "keys": list(root.keys()), "scalars": scalars, "texts": texts}))


if __name__ == "__main__":
    _main(*sys.argv[1:])
