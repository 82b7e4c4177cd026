"""Lines of a journal: one JSON object each, with a check of its content: none is read other than it was written.

The check is no secret: whoever wants to can make one. It finds what an editor, a merge or a bad disk has changed.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

CHECK = "check"


def sealed(record: dict[str, Any]) -> str:
    """The line of a record of plain JSON data, without its end. Raises ValueError for what is not finite."""
    return json.dumps({**record, CHECK: _digest(record)}, allow_nan=False, separators=(",", ":"))


def unsealed(line: str | bytes) -> dict[str, Any]:
    """The record of a line.

    Raises
    ------
    ValueError  if it is no JSON object, holds a number that is not finite, or is not what was written.
    """
    try:
        record = json.loads(line, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    if not isinstance(record, dict):
        raise ValueError("it is no JSON object")
    check = record.pop(CHECK, None)
    if check != _digest(record):
        raise ValueError("it is not what was written")
    return record


def open_for_appending(path: Path) -> int:
    """A descriptor of a regular file, made where there is none; no link is followed and no pipe waited for.

    Raises
    ------
    OSError  if it cannot be opened so.
    """
    more = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    return os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | more, 0o666)


def _digest(record: dict[str, Any]) -> str:
    try:
        text = json.dumps(record, sort_keys=True, allow_nan=False)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _refuse(constant: str) -> None:
    raise ValueError(f"expected finite numbers, got {constant}")
