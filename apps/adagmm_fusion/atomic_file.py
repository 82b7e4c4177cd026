"""Files appear under their final name complete or not at all."""

import os
import tempfile
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
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        # mkstemp makes files private; a result should be as readable as any other new file.
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)
        yield Path(temporary)
        os.replace(temporary, path)
    except OutputError:
        raise
    except OSError as problem:
        raise OutputError(f"{path}: cannot be written: {problem.strerror or problem}") from problem
    finally:
        if temporary is not None and os.path.exists(temporary):
            os.unlink(temporary)


def write_text(path, text: str):
    """Write a UTF-8 text file atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
