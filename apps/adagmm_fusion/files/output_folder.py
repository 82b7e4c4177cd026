"""Folders of results: a new one, and one run at a time writes into it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.file_lock import lock
from adagmm_o3d.errors import AdaGMMError

NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # Windows has none


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
        handle = None if os.name == "nt" else os.open(folder, os.O_RDONLY | (0 if follow_links else NO_LINK))
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


def check_apart(recording: Path, folder: Path | None, file: str | Path | None) -> None:
    """Before the work: whether the recording stays as it is. Results among its files could be read as parts of it, a
    trajectory as its ground truth; in a folder of their own within it they do no harm.

    folder : where results go, if anywhere.    file : the Rerun recording, if one is to be saved.

    Raises
    ------
    OutputError  if `folder` is the recording's own, or `file` would replace a file in it.
    """
    whole = Path(os.path.realpath(recording))
    if folder is not None and Path(os.path.realpath(folder)) == whole:
        raise OutputError(f"{folder}: expected a folder for results, it is the recording; give another --output")
    if file is None or not os.path.lexists(file) or Path(file).suffix == ".rrd":
        return
    place = Path(os.path.realpath(file))
    if whole == place or whole in place.parents:
        raise OutputError(f"{file}: expected a name for results, it is a file of the recording; give another --save")


def _locked(handle: int) -> bool:
    try:
        return lock(handle)
    except OSError:  # some network file systems lock no folders
        return True
