"""The docstrings' own layout as Markdown, for the API reference: lists of arguments are lists there too."""

import re
from typing import Any

import griffe

HEADING = re.compile(r"-{3,}")
ARGUMENT = re.compile(r"([A-Za-z_][\w.]*(?:, [A-Za-z_]\w*)*) +: +(.*)")
ERROR = re.compile(r"([A-Z]\w*(?:, [A-Z]\w*)*)  +(.*)")


def as_markdown(docstring: str) -> str:
    """A docstring with its headings in bold, and with a list item for every "name : text" and "Error  if ..."."""
    lines = docstring.splitlines()
    written: list[str] = []
    in_item = False
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        item = ARGUMENT.fullmatch(line) or ERROR.fullmatch(line)
        if HEADING.fullmatch(line):
            continue
        if HEADING.fullmatch(following):
            written += ["", f"**{line}**", ""]
            in_item = False
        elif item:
            written += [*([] if in_item else [""]), f"- `{item[1]}`: {item[2]}"]
            in_item = True
        elif in_item and line.startswith("  "):
            written.append(f"  {line.strip()}")
        else:
            written += ["", line] if in_item and line else [line]
            in_item = False
    return "\n".join(written)


class HouseDocstrings(griffe.Extension):
    """Rewrites every docstring that is shown."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value)
