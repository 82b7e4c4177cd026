"""One run at a time writes into a folder of results."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.file_lock import lock


@contextmanager
def exclusive(folder: Path) -> Iterator[None]:
    """Make the folder where it is missing; within, no other run gets it. However this one ends, it is free again.

    Raises
    ------
    OutputError  if the folder cannot be made, or another run has it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # Windows opens no folders: two runs into one are not told apart there
        handle = None if os.name == "nt" else os.open(folder, os.O_RDONLY)
    except OSError as problem:
        raise OutputError(f"{folder}: cannot be written: {problem.strerror}") from problem
    try:
        if handle is not None and not _locked(handle):
            raise OutputError(f"{folder}: another run is writing here; give this one another --output")
        yield
    finally:
        if handle is not None:
            os.close(handle)


def _locked(handle: int) -> bool:
    try:
        return lock(handle)
    except OSError:  # some network file systems lock no folders
        return True
