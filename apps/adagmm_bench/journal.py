"""Results as they come: one JSON object a line, so that a run that was stopped goes on where it was.

The last line may be torn by a power cut or a kill; it is dropped. Anything else that is not a record as it was written
is an error.
"""

from __future__ import annotations

import os
from pathlib import Path

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import check_output_file
from adagmm_fusion.files.file_lock import lock
from adagmm_fusion.files.journal_lines import open_for_appending, sealed, unsealed
from adagmm_o3d.errors import InputError


class Journal:
    """Records by their "key", appended to a file that one process at a time may hold open; `fresh`: emptied first.

    Raises
    ------
    OutputError  if the file is no regular one or cannot be written, or another run holds it.
    InputError   if a line other than the last is not a record (file and line are named).
    """

    def __init__(self, path: Path, *, fresh: bool = False) -> None:
        self.path = path
        check_output_file(path)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = os.fdopen(open_for_appending(path), "a+b", buffering=0)  # closed by __exit__
            if not lock(self._file.fileno()):
                self._file.close()
                raise OutputError(f"{path}: another run is writing here; give this one another --output")
            if fresh:
                self._file.truncate(0)
        except OutputError:
            raise
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
        try:
            self.records: dict[str, dict] = self._read()
        except InputError:
            self._file.close()
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def append(self, record: dict) -> None:
        """Add a record, or replace the one of its key. It is in the file when this returns.

        Raises
        ------
        OutputError  if there is no room for it; the file holds what it held before.
        """
        left = sealed(record).encode() + b"\n"
        whole = self._file.seek(0, os.SEEK_END)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self._file.truncate(whole)
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from error
        self.records[record["key"]] = record

    def _read(self) -> dict[str, dict]:
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            self._file.truncate(whole)
        records = {}
        for number, line in enumerate(content[:whole].splitlines(), start=1):
            try:
                record = unsealed(line)
                records[record["key"]] = record
            except (ValueError, KeyError, TypeError) as error:
                wanted = "expected a JSON record with a key, as it was written"
                told = f"{wanted}, got {line[:60]!r}; take the line away, or start anew with --fresh"
                raise InputError(f"{self.path}:{number}: {told}") from error
        return records
