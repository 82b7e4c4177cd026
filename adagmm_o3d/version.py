"""The version of everything in this distribution, written here alone; CHANGELOG.md says what its numbers promise."""

__version__ = "0.1.0"
