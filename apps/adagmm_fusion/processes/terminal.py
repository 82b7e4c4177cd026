"""What a command prints, whatever takes it: another encoding, a full disk, a pipe whose reader has gone, nothing.

Only what is printed degrades; files are UTF-8.
"""

import codecs
import contextlib
import errno
import os
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.console import Console

# What our tables and sentences are written with, in plain letters for encodings that lack it.
PLAIN = {
    "°": "deg",
    "σ": "sigma",
    "±": "+-",
    "–": "-",
    "‖": "||",
    "−": "-",
    "⁻": "^-",
    "¹": "1",
    "²": "2",
    "≤": "<=",
    "×": "x",
    "→": "->",
    "…": "...",
    "δ": "delta",
    "ᵀ": "^T",
}
ERRORS = "adagmm_plain"
# Of tables where the output is no terminal.
TABLE_WIDTH = 150
# What writing to a terminal, pipe or file that is full or gone ends with.
LOST_OUTPUT = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EPIPE, errno.EBADF)
NO_MORE_FILES = (errno.EMFILE, errno.ENFILE)


def printable(text: object) -> str:
    """A name as it can be printed in a line: what would move a terminal's cursor, or end the line, is escaped."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in str(text))


def table_console(width: int = TABLE_WIDTH, *, stderr: bool = False) -> "Console":
    """Where tables are printed: as wide as the terminal, or as `width` where the output is none."""
    from rich.console import Console

    console = Console(stderr=stderr, highlight=False, soft_wrap=True)
    return console if console.is_terminal else Console(stderr=stderr, highlight=False, soft_wrap=True, width=width)


def printing(program: str, command: Callable[[], int]) -> int:
    """The exit code of a command that prints; 1 where its output could not be printed, or the machine gives no more
    memory or files, which stderr then says.

    Characters that stdout or stderr cannot encode are written in plain letters or as escapes.
    """
    with _there(), _degrading():
        try:
            try:
                return command()
            finally:
                sys.stdout.flush()
        except MemoryError as problem:
            say(f"{program}: the memory is not enough ({str(problem) or 'no more is given'}); take less data at a time")
            return 1
        except OSError as problem:
            if problem.errno in NO_MORE_FILES:
                say(f"{program}: too many files are open; allow more, as with ulimit -n 1024")
                return 1
            if problem.errno not in LOST_OUTPUT or problem.filename is not None:
                raise
            _abandon(sys.stdout)
            if isinstance(problem.__context__, KeyboardInterrupt):  # it was stopped, and then could not print
                raise problem.__context__ from None
            if not isinstance(problem, BrokenPipeError):  # the reader has seen enough
                say(f"{program}: the output cannot be printed: {problem.strerror}")
            return 1


def say(line: str) -> None:
    """Print a line on stderr, if somebody is there to read it."""
    try:
        print(line, file=sys.stderr, flush=True)
    except (OSError, ValueError):  # ValueError: it is closed
        _abandon(sys.stderr)


@contextlib.contextmanager
def _there() -> Iterator[None]:
    """Within, stdout and stderr are there, though the process may have been started without."""
    with contextlib.ExitStack() as stack:
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is None:
                setattr(sys, name, stack.enter_context(open(os.devnull, "w", encoding="utf-8")))
                stack.callback(setattr, sys, name, None)
        yield


@contextlib.contextmanager
def _degrading() -> Iterator[None]:
    streams = [stream for stream in (sys.stdout, sys.stderr) if hasattr(stream, "reconfigure")]
    before = [stream.errors for stream in streams]
    for stream in streams:
        _reconfigure(stream, ERRORS)
    try:
        yield
    finally:
        for stream, errors in zip(streams, before, strict=True):
            _reconfigure(stream, errors)


def _reconfigure(stream: Any, errors: str | None) -> None:
    # It flushes first, and seeks where what is behind the stream could do that once.
    with contextlib.suppress(OSError, ValueError):
        stream.reconfigure(errors=errors)


def _abandon(stream: TextIO) -> None:
    """What is left in a stream's buffer goes nowhere, so that the interpreter does not fail at its end to write it."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _plain(problem: UnicodeError) -> tuple[str, int]:
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    text = problem.object[problem.start : problem.end]
    return "".join(PLAIN.get(c) or ascii(c)[1:-1] for c in text), problem.end


codecs.register_error(ERRORS, _plain)
