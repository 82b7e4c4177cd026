"""Files that are read: only regular ones, for a pipe may never end, and none whole without bound."""

import errno
import hashlib
import os
import stat
from collections.abc import Iterable
from pathlib import Path

from adagmm_o3d.errors import InputError

LEAST_READ = 1 << 16  # files of the system say that they have 0 bytes
MAX_BYTES = 1 << 28  # far more than an image, a list of images or a calibration


def is_given(path: Path) -> bool:
    """Whether anything has this name: `Path.is_file` takes a pipe, a device or a link to nothing for absent, and they
    would be passed over in silence; whoever reads them then with `read_input` is told what they are.

    Raises
    ------
    OSError  if the folder may not be looked into.
    """
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return False
    return True


def visible(paths: Iterable[Path]) -> list[Path]:
    """Of a listing what is not hidden, by name: beside each file on another system's disk macOS writes a ._ file, which
    ends as the file does and holds something else."""
    return sorted(path for path in paths if not path.name.startswith("."))


def check_input(path: Path, error: type[InputError], *, missing: str | None = None) -> None:
    """Before another library opens a file, which would wait for ever for what a pipe may bring.

    Raises
    ------
    error  naming the file, if it is not there (`missing` says so), cannot be read, or is no file.
    """
    read_input(path, error, count=0, missing=missing, bounded=False)


def read_input(
    path: Path, error: type[InputError], *, count: int = MAX_BYTES, missing: str | None = None, bounded: bool = True
) -> bytes:
    """The bytes of a file, links followed; with `count` its first ones.

    Raises
    ------
    error  naming the file, if it is not there (`missing` says so), cannot be read, is no file, or, if it is to
        be `bounded`, has more than MAX_BYTES.
    """
    try:
        with open(path, "rb", opener=_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise error(f"{path}: cannot be read: it is a pipe or a device, not a file")
            if bounded and status.st_size > MAX_BYTES:
                raise error(
                    f"{path}: cannot be read: expected at most {MAX_BYTES >> 20} MiB, got {status.st_size >> 20}"
                )
            # As much memory as the file needs, not as much as it might.
            return file.read(min(count, max(status.st_size, LEAST_READ)))
    except error:
        raise
    except ValueError as problem:  # a NUL byte in its name
        raise error(f"{path}: cannot be read: {problem}") from problem
    except OSError as problem:
        if os.path.islink(path) and not os.path.exists(path):
            raise error(f"{path}: cannot be read: it is a link to nothing") from problem
        if problem.errno == errno.ENXIO:
            raise error(f"{path}: cannot be read: it is a socket, not a file") from problem
        if missing is not None and isinstance(problem, FileNotFoundError):
            raise error(f"{path}: {missing}") from problem
        raise error(f"{path}: cannot be read: {problem.strerror}") from problem


def input_digest(path: Path, error: type[InputError]) -> str:
    """Twelve digits that change with a file's content; see `read_input`."""
    return hashlib.sha256(read_input(path, error)).hexdigest()[:12]


def read_input_text(path: Path, error: type[InputError]) -> str:
    """The text of a UTF-8 file, without the mark that editors of Windows put before it; see `read_input`."""
    try:
        return read_input(path, error).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        byte = problem.object[problem.start]
        raise error(f"{path}: expected UTF-8 text, got byte {byte:#04x}; is it a binary file?") from problem


def _without_waiting(path: str, flags: int) -> int:
    """Open a pipe without waiting for somebody to write into it."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))
