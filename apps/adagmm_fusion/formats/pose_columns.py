"""Which columns of a table of poses are x y z and the quaternion, as a line of headings or a comment names them.

Without such a line they are tx ty tz qx qy qz qw, as the TUM benchmark has them.
"""

import re
from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats.text_table import is_lost, parse_numbers, read_lines

AXES = {"position": "xyz", "quaternion": "xyzw"}
# tx, pos_x, position.x, p_RS_R_x [m]; qx, q_x, quat_x, rot_x, orientation.x
NAMED = {
    "position": re.compile(r"(?:t|p|pos\w*|trans\w*|loc\w*|cam\w*|p_rs_r_?)?[._]?([xyz])"),
    "quaternion": re.compile(r"(?:q|quat\w*|rot\w*|orient\w*|q_rs_?)[._]?([xyzw])"),
}


def quaternion_columns(path: Path) -> list[str] | None:
    """The headings of a file's columns, as x y z of the position and quaternion; None where no line names them.

    Returns
    -------
    For each column its role and axis, such as "position x", or "".

    Raises
    ------
    RecordingError  if a line names some of them and not all: read as usual they might be taken for each other.
    """
    for where, line in takewhile(lambda numbered: not _is_data(numbered[1]), read_lines(path)):
        words = re.split(r"[\s,;]+", re.sub(r"\[.*?\]|\(.*?\)", "", line).strip("#/% \t,;").lower())
        columns = [_role(word) for word in words]
        if not any(column.startswith("quaternion") for column in columns) and not set("wxyz") <= set(words):
            continue  # it is about something else
        if sorted(filter(None, columns)) != sorted(f"{role} {axis}" for role, axes in AXES.items() for axis in axes):
            raise RecordingError(
                f"{where}: expected headings such as timestamp tx ty tz qx qy qz qw, got {line[:80]!r}; name them so"
            )
        return columns
    return None


def in_usual_order(words: Sequence[str], columns: Sequence[str] | None, where: str) -> list[str]:
    """A row's words as [key] tx ty tz qx qy qz qw, whatever order `quaternion_columns` found; the key is the frame's
    number or time, where there is one."""
    if columns is None:
        return list(words)
    if len(columns) != len(words) and len(words) in (7, 8):
        # Of the other columns not all are named: the seven are together, and behind the key.
        named = [i for i, column in enumerate(columns) if column]
        if named[-1] - named[0] == 6:
            columns = ["key"] * (len(words) - 7) + list(columns[named[0] : named[-1] + 1])
    if len(columns) != len(words):
        raise RecordingError(f"{where}: expected {len(columns)} numbers, got {len(words)} words, unlike the headings")
    usual = [columns.index(f"{role} {axis}") for role, axes in AXES.items() for axis in axes]
    key = [i for i in range(len(words)) if i not in usual][:1]
    return [words[i] for i in (*key, *usual)]


def _role(word: str) -> str:
    for role, pattern in NAMED.items():
        if (found := pattern.fullmatch(word)) is not None:
            return f"{role} {found[1]}"
    return ""


def _is_data(line: str) -> bool:
    words = re.sub(r"[,;\[\]]", " ", line.split("#", 1)[0]).split()
    try:
        return bool(words) and bool(parse_numbers(words[-1:], 1, ""))
    except RecordingError:
        return is_lost(words[-1:])
