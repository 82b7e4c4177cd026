"""Folders of results: a new one, and one run at a time writes into it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.file_lock import lock
from adagmm_o3d.errors import AdaGMMError


@contextmanager
def exclusive(folder: Path, *, follow_links: bool = True) -> Iterator[None]:
    """Make the folder where it is missing; within, no other run gets it. However this one ends, it is free again.

    follow_links : whether it may be a link to a folder.

    Raises
    ------
    OutputError  if the folder cannot be made, or another run has it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not follow_links and folder.is_symlink():
            raise OutputError(f"{folder}: expected a folder, it is a link; take it away")
        # Windows opens no folders: two runs into one are not told apart there
        handle = None if os.name == "nt" else os.open(folder, os.O_RDONLY | (0 if follow_links else os.O_NOFOLLOW))
    except OutputError:
        raise
    except ValueError as problem:  # a NUL byte in its name
        raise OutputError(f"{folder}: cannot be written: {problem}") from problem
    except OSError as problem:
        raise OutputError(f"{folder}: cannot be written: {problem.strerror}") from problem
    try:
        if handle is not None and not _locked(handle):
            raise OutputError(f"{folder}: another run is writing here; give this one another --output")
        yield
    finally:
        if handle is not None:
            os.close(handle)


def check_new_folder(folder: Path, error: type[AdaGMMError] = OutputError) -> None:
    """Raise `error` where a folder is already, unless it is empty, or where none can be."""
    try:
        taken = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    except OSError as problem:  # a name that is too long, a folder that may not be looked into
        raise error(f"{folder}: cannot be written: {problem.strerror}") from problem
    if taken:
        raise error(f"{folder}: is there already and not an empty folder; give a new one")


def _locked(handle: int) -> bool:
    try:
        return lock(handle)
    except OSError:  # some network file systems lock no folders
        return True
