"""Files appear under their final name complete or not at all, and only in the place of a file or of none."""

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from adagmm_fusion.errors import OutputError


def check_output_file(path: str | Path) -> None:
    """Before the work is done: whether a result can be written here, as far as that can be known.

    Raises
    ------
    OutputError  if the name is empty, or of what is no regular file (a folder, a link, a device), or lies where no file
        can be made.
    """
    text = os.fspath(path)
    if not os.path.basename(text) or "\0" in text or os.path.basename(text) in (".", ".."):
        raise OutputError(f"{text or 'an empty name'}: expected the name of a file to write")
    try:
        found = _status(Path(path))
        if found is not None and not stat.S_ISREG(found.st_mode):
            kind = _kind(found.st_mode)
            raise OutputError(f"{path}: expected a file to replace, or none, it is {kind}; give another name")
        folder = Path(path).parent
        while not folder.exists() and folder != folder.parent:
            folder = folder.parent
        if not folder.is_dir():
            raise OutputError(f"{path}: cannot be written: {folder} is no folder")
        if not os.access(folder, os.W_OK | os.X_OK):
            raise OutputError(f"{path}: cannot be written: no file can be made in {folder}")
    except OutputError:
        raise
    except OSError as problem:  # a name that is too long
        raise OutputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """The path of a temporary file beside `path`, with the same suffix; it takes its place when the block ends well.

    The temporary file is made exclusively and under a random name, so that nothing that lies there, or that somebody
    has planted there, is written through.

    Raises
    ------
    OutputError  as `check_output_file`, or if the folder cannot be made or written, or the file not be put in place.
    """
    check_output_file(path)
    path = Path(path)
    # The name is chosen before the file is made, so that an interrupt at any moment finds what to remove.
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(8)}{path.suffix}")
    made = False
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        made = True
        os.close(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), 0o666))
        yield temporary
        os.replace(temporary, path)
    except OutputError:
        raise
    except OSError as problem:
        raise OutputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem
    finally:
        if made:
            temporary.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file atomically."""
    with replacing(path) as temporary:
        # Names of files may hold what is no Unicode.
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _kind(mode: int) -> str:
    kinds = ((stat.S_ISDIR, "a folder"), (stat.S_ISLNK, "a link"), (stat.S_ISFIFO, "a pipe"))
    return next((name for is_kind, name in kinds if is_kind(mode)), "a device")
