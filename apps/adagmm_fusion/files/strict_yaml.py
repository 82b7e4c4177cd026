"""YAML read strictly: every value knows its line, and what is not wanted is refused rather than ignored.

Only plain data is accepted: one document of mappings, sequences and scalars. Anchors, aliases, tags, duplicate keys and
unknown keys are errors, because a calibration that ignores half of its file is worse than one that does not load.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import yaml

from adagmm_fusion.files.input_file import read_input_text
from adagmm_o3d.errors import InputError

NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
# Escapes can stand for characters that are not text: half of a surrogate pair, or commands to a terminal.
NO_TEXT = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
MAX_DEPTH = 12
MAX_VALUES = 1 << 22  # of a document; an hour of frames with their poses has a million
# libyaml, where PyYAML was built with it, is twenty times as fast.
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class Item:
    """One value of the document: a dict of Items, a list of Items, or a scalar's text (`quoted` or plain)."""

    value: dict | list | str
    path: Path
    line: int
    label: str
    error: type[InputError]
    quoted: bool = False

    def fail(self, message: str) -> NoReturn:
        """Raise this document's error about this value."""
        raise self.error(f"{self.path}:{self.line}: {self.label}: {' '.join(message.split())}")

    def mapping(self, required: Iterable[str] = (), optional: Iterable[str] = ()) -> "dict[str, Item]":
        """The keys and values; exactly `required` and any of `optional` when either is given."""
        if not isinstance(self.value, dict):
            self.fail(f"expected a mapping (key: value), got {self._kind()}")
        if required or optional:
            known = dict.fromkeys([*required, *optional])
            for key, item in self.value.items():
                if key not in known:
                    item.fail(f"unknown key {key!r}; known here: {', '.join(known)}")
            for key in required:
                if key not in self.value:
                    self.fail(f"key {key!r} is missing")
        return self.value

    def sequence(self) -> "list[Item]":
        if not isinstance(self.value, list):
            self.fail(f"expected a list, got {self._kind()}")
        return self.value

    def text(self) -> str:
        if not isinstance(self.value, str):
            self.fail(f"expected text, got {self._kind()}")
        if not self.value:
            self.fail("expected text, got nothing")
        return self.value

    def literal(self, wanted: str) -> str:
        """The text, which must be `wanted`."""
        if self.text() != wanted:
            self.fail(f"expected {wanted}, got {self.value}")
        return wanted

    def integer(self) -> int:
        text = self.text()
        if self.quoted or not INTEGER.fullmatch(text):
            self.fail(f"expected an integer, got {text!r}")
        return int(text)

    def number(self) -> float:
        text = self.text()
        if self.quoted or not NUMBER.fullmatch(text):
            self.fail(f"expected a finite number, got {text!r}")
        number = float(text)
        if not np.isfinite(number):
            self.fail(f"expected a finite number, got {text!r}, which is too large")
        return number

    def numbers(self) -> tuple[float, ...]:
        return tuple(item.number() for item in self.sequence())

    def matrix(self, rows: int, columns: int) -> np.ndarray:
        """A list of `rows` lists of `columns` numbers."""
        items = self.sequence()
        if len(items) != rows:
            self.fail(f"expected {rows} rows of {columns} numbers, got {len(items)}")
        table = [item.numbers() for item in items]
        for item, row in zip(items, table, strict=True):
            if len(row) != columns:
                item.fail(f"expected {columns} numbers, got {len(row)}")
        return np.array(table)

    def _kind(self) -> str:
        return {dict: "a mapping", list: "a list"}.get(type(self.value)) or repr(self.value)


def read_yaml(path: str | Path, error: type[InputError]) -> Item:
    """The document in a UTF-8 file; `error` is the class to raise for whatever is wrong with it."""
    path = Path(path)
    text = read_input_text(path, error)
    try:
        return _Builder(path, error, yaml.parse(text, Loader=LOADER)).document()
    except InputError:
        raise
    except (ValueError, OverflowError) as problem:  # an escape such as \\UFFFFFFFF, which is no character
        raise error(f"{path}: not valid YAML: {problem}") from problem
    except yaml.YAMLError as problem:
        mark = getattr(problem, "problem_mark", None)
        where = f":{mark.line + 1}" if mark else ""
        reason = getattr(problem, "problem", None) or getattr(problem, "reason", None) or "not YAML"
        raise error(f"{path}{where}: not valid YAML: {' '.join(str(reason).split())}") from problem


class _Builder:
    """Turns the parser's events into Items, refusing what is not plain data."""

    def __init__(self, path: Path, error: type[InputError], events: Any):
        self.path, self.error, self.events, self.values = path, error, events, 0

    def document(self) -> Item:
        next(self.events)  # start of the stream
        if not isinstance(next(self.events), yaml.DocumentStartEvent):
            raise self.error(f"{self.path}: the file is empty")
        root = self.item(next(self.events), "the document", 0)
        next(self.events)  # end of the document
        if not isinstance(end := next(self.events), yaml.StreamEndEvent):
            raise self.error(f"{self.path}:{end.start_mark.line + 1}: expected one document, got a second one")
        return root

    def item(self, event: Any, label: str, depth: int) -> Item:
        line = event.start_mark.line + 1
        where = f"{self.path}:{line}: {label}"
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise self.error(f"{where}: anchors and aliases (&, *) are not allowed, write the value out")
        if event.tag is not None:
            raise self.error(f"{where}: tags ({event.tag}) are not allowed")
        if depth > MAX_DEPTH:
            raise self.error(f"{where}: nested more than {MAX_DEPTH} levels deep")
        self.values += 1
        if self.values > MAX_VALUES:
            raise self.error(f"{where}: expected a document of at most {MAX_VALUES} values")
        quoted = False
        if isinstance(event, yaml.ScalarEvent):
            value, quoted = event.value, event.style not in (None, "")  # "": libyaml's word for plain
            if found := NO_TEXT.search(value):
                raise self.error(f"{where}: expected text, got the character {found[0]!a} in it")
        elif isinstance(event, yaml.SequenceStartEvent):
            value = []
            while not isinstance(child := next(self.events), yaml.SequenceEndEvent):
                value.append(self.item(child, f"{label}[{len(value)}]", depth + 1))
        else:
            value = self.entries(label, depth)
        return Item(value, self.path, line, label, self.error, quoted)

    def entries(self, label: str, depth: int) -> dict[str, Item]:
        entries: dict[str, Item] = {}
        prefix = f"{label}." if depth else ""
        while not isinstance(event := next(self.events), yaml.MappingEndEvent):
            item = self.item(event, f"{label}: a key", depth + 1)
            key = item.text()
            if not key.isprintable():
                item.fail(f"expected one line, got {key!r}")
            if key in entries:
                line = event.start_mark.line + 1
                raise self.error(f"{self.path}:{line}: {prefix}{key}: given twice, first in line {entries[key].line}")
            entries[key] = self.item(next(self.events), f"{prefix}{key}", depth + 1)
        return entries
