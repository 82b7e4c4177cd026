"""The numbers in a file of OpenCV's FileStorage, read by a process of its own.

On some damaged files OpenCV does not raise an error but ends the process. The child prints what it found as JSON:

    python -m adagmm_fusion.files.opencv_nodes FILE NAME...
"""

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

TIMEOUT_S = 60
MEMORY_BYTES = 2 << 30
MAX_NUMBERS = 1000  # of one matrix or list; a calibration has a dozen


def read_nodes(path: Path, names: tuple[str, ...]) -> dict[str, np.ndarray] | None:
    """Those of the named top-level numbers, lists and matrices that are there; None if the file is none of OpenCV's."""
    command = [sys.executable, "-m", "adagmm_fusion.files.opencv_nodes", str(path), *names]
    try:
        done = subprocess.run(command, capture_output=True, timeout=TIMEOUT_S, check=True)
        return {name: np.array(values, dtype=float) for name, values in json.loads(done.stdout).items()}
    except (subprocess.SubprocessError, ValueError):
        return None


def _numbers(node: cv2.FileNode) -> list | float:
    if node.isMap():
        if any(node.getNode(key).real() > MAX_NUMBERS for key in ("rows", "cols")):
            raise ValueError("a matrix that is too large")
        return node.mat().tolist()
    if node.isSeq():
        return [node.at(i).real() for i in range(min(node.size(), MAX_NUMBERS))]
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
    nodes = {name: storage.getNode(name) for name in names}
    print(json.dumps({name: _numbers(node) for name, node in nodes.items() if not node.empty()}))


if __name__ == "__main__":
    _main(*sys.argv[1:])
