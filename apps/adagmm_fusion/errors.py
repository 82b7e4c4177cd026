"""The app's own errors. A message starts with the file it is about and fits on one line."""

from adagmm_o3d.errors import AdaGMMError, InputError


class RecordingError(InputError):
    """A recording is missing something, or holds something that cannot be used."""


class RigError(InputError):
    """A rig file cannot be used, or lacks a sensor that is asked for."""


class OutputError(AdaGMMError, OSError):
    """A result cannot be written where it was asked for."""
