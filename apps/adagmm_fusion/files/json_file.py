"""JSON files from outside: what is in them is checked when it is taken out."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import read_input_text


def read_json(path: Path) -> Any:
    """The document. Raises RecordingError, naming the file, if it cannot be read or is not JSON."""
    return parse_json(read_input_text(path, RecordingError), path)


def parse_json(text: str | bytes, path: Path) -> Any:
    """The document in a text that came from `path`; see `read_json`."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as problem:
        reason = "nested too deeply" if isinstance(problem, RecursionError) else " ".join(str(problem).split())
        raise RecordingError(f"{path}: not valid JSON: {reason}") from problem


def json_object(value: Any, where: str) -> dict[str, Any]:
    """The value, which must be an object (a dict)."""
    if not isinstance(value, dict):
        raise RecordingError(f"{where}: expected an object {{...}}, got {_kind(value)}")
    return value


def json_number(values: dict[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A finite number under a key; `default` where there is none."""
    value = values.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < math.inf:
        raise RecordingError(f"{where}: {key}: expected a finite number, got {_kind(value)}")
    return float(value) if abs(value) < 1e300 else (1e300 if value > 0 else -1e300)


def json_numbers(value: Any, count: int, where: str) -> np.ndarray:
    """(count,) float64 of a list of numbers, or of a list of lists of them, row by row."""
    flat: list[Any] = []
    for item in value if isinstance(value, list) else [value]:
        flat += item if isinstance(item, list) else [item]
    numbers = [x for x in flat if isinstance(x, int | float) and not isinstance(x, bool) and abs(x) < 1e300]
    if len(flat) != count or len(numbers) != count:
        raise RecordingError(f"{where}: expected {count} finite numbers, got {_kind(value)}")
    return np.array(numbers, dtype=np.float64)


def _kind(value: Any) -> str:
    if isinstance(value, dict | list):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    return "nothing" if value is None else repr(value)[:40]
