"""Text files of words and numbers, line by line, without blank lines and # comments; errors name file and line."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import read_input_text
from adagmm_fusion.frames.rgbd import checked_rigid_transformation
from adagmm_o3d.errors import InputError

NUMBER_WITH_COMMA = re.compile(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?")


def read_lines(path: Path) -> Iterator[tuple[str, str]]:
    """("file:line", the line) of each line that is not blank, comments included."""
    for number, line in enumerate(read_input_text(path, RecordingError).splitlines(), 1):
        if line.strip():
            yield f"{path}:{number}", line.strip()


def read_rows(path: Path) -> Iterator[tuple[str, list[str]]]:
    """("file:line", the words) of each line that has any."""
    for where, line in read_lines(path):
        words = line.split("#", 1)[0].split()
        if words:
            yield where, words


def with_decimal_points(line: str) -> str:
    """A line of numbers between semicolons or spaces that have decimal commas, with points; any other as it is."""
    words = re.split(r"[;\s]+", line.strip("; \t"))
    if len(words) < 2 or not all(NUMBER_WITH_COMMA.fullmatch(word) for word in words):
        return line
    return line.replace(",", ".")


def parse_numbers(words: list[str], count: int, where: str) -> list[float]:
    """Exactly `count` finite numbers."""
    if len(words) != count:
        raise RecordingError(f"{where}: expected {count} numbers, got {len(words)} words")
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        bad = next(word for word in words if not _is_number(word))
        raise RecordingError(f"{where}: expected {count} numbers, got {bad!r}") from None
    if not np.isfinite(numbers).all():
        raise RecordingError(f"{where}: expected finite numbers, got {' '.join(words)}")
    return numbers


def parse_pose(numbers: ArrayLike, where: str) -> np.ndarray:
    """(4, 4) rigid transformation from 16 numbers, row by row."""
    try:
        return checked_rigid_transformation(np.reshape(numbers, (4, 4)), "pose")
    except InputError as problem:
        raise RecordingError(f"{where}: {problem}") from problem


def parse_pose_or_lost(words: Sequence[str], where: str) -> np.ndarray | None:
    """`parse_pose` of 16 words; None where they hold NaN or infinity: tracking was lost."""
    return None if is_lost(words) else parse_pose(parse_numbers(list(words), 16, where), where)


def is_lost(words: Sequence[str]) -> bool:
    return any(word.lower().lstrip("+-") in ("nan", "inf", "infinity") for word in words)


def parse_quaternion_pose(numbers: Sequence[float], where: str) -> np.ndarray:
    """(4, 4) rigid transformation from x y z qx qy qz qw."""
    quaternion = np.array(numbers[3:], dtype=np.float64)
    if quaternion.shape != (4,) or abs(np.linalg.norm(quaternion) - 1) > 0.01:
        raise RecordingError(f"{where}: expected a unit quaternion qx qy qz qw, got {quaternion.tolist()}")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), numbers[:3]
    return parse_pose(T, where)


def read_matrix(path: Path, rows: int, columns: int) -> np.ndarray:
    """A file that holds one matrix, a row a line."""
    table = [parse_numbers(words, columns, where) for where, words in read_rows(path)]
    if len(table) != rows:
        raise RecordingError(f"{path}: expected {rows} lines of {columns} numbers, got {len(table)}")
    return np.array(table)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
