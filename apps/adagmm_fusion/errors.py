"""The app's own errors. A message starts with the file it is about and fits on one line."""

from adagmm_fusion.processes.terminal import printable
from adagmm_o3d.errors import AdaGMMError, InputError

__all__ = ["AdaGMMError", "OutputError", "RecordingError", "RigError", "one_line"]


MAX_LENGTH = 2000  # of a line


class RecordingError(InputError):
    """A recording is missing something, or holds something that cannot be used."""


class RigError(InputError):
    """A rig file cannot be used, or lacks a sensor that is asked for."""


def one_line(problem: Exception | str) -> str:
    """A message as it can be printed: what it quotes from a file, or a file's name, may hold anything, and a lot."""
    text = printable(" ".join(str(problem).split()))
    return text if len(text) <= MAX_LENGTH else f"{text[: MAX_LENGTH // 2]} … {text[-MAX_LENGTH // 2 :]}"


class OutputError(AdaGMMError, OSError):
    """A result cannot be written where it was asked for."""
