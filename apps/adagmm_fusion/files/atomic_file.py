"""Files appear under their final name complete or not at all."""

import os
import secrets
from contextlib import contextmanager
from pathlib import Path

from adagmm_fusion.errors import OutputError


@contextmanager
def replacing(path):
    """The path of a temporary file beside `path`, with the same suffix; it takes its place when the block ends well.

    Raises
    ------
    OutputError  if the folder cannot be made or written, or the file cannot be put in place.
    """
    path = Path(path)
    # The name is chosen before the file is made, so that an interrupt at any moment finds what to remove.
    temporary = path.with_name(f".{path.stem}-{secrets.token_hex(8)}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.touch(exist_ok=False)
        yield temporary
        os.replace(temporary, path)
    except OutputError:
        raise
    except OSError as problem:
        raise OutputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem
    finally:
        if temporary.exists():
            temporary.unlink()


def write_text(path: str | Path, text: str) -> None:
    """Write a UTF-8 text file atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
