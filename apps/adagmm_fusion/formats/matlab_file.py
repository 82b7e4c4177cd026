"""MATLAB .mat files, level 5 (what `save` writes up to version 7): real numeric arrays, and structures of them and of
other structures. Fields of other kinds, such as text, are left out.

    file        128 bytes header (the last four: version 0x0100, "IM"), then elements
    element     uint32 type, uint32 size, data, padded to 8 bytes; or, up to 4 bytes, uint16 type, uint16 size, 4 bytes
    compressed  an element of type 15: zlib data that is one element, unpadded
    matrix      an element of type 14 made of elements: flags (its first byte the class), dimensions (int32), name, and
                a numeric class: the values column by column, in a type that may be smaller than the class;
                a structure: the length of a field's name, the names one behind the other, one matrix a field
                an object of a class of MATLAB's: flags, name, "MCOS", and a reference to what nobody else can read

Read here because SciPy's reader can crash the process on a damaged file. Source: MathWorks, MAT-File Format, level 5.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import read_input

VALUE_DTYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 9: "<f8", 12: "<i8", 13: "<u8"}
CLASS_DTYPES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
STRUCTURE, OPAQUE, MATRIX, COMPRESSED, COMPLEX = 2, 17, 14, 15, 0x0800
MAX_BYTES = 1 << 26  # of the variable that is read; far more than an image
HEAD_BYTES = 1024  # a variable's flags, dimensions and name are in these
MAX_VARIABLES = 10_000
MAX_DIMENSIONS = 8
MAX_DEPTH = 4  # of structures in structures

Value = np.ndarray | dict[str, Any]


class _Damaged(Exception):
    """What is wrong with the bytes."""


class _OtherKind(Exception):
    """What is there, well-formed, but no array of real numbers and no structure."""


def read_variable(path: Path, name: str) -> Value:
    """The variable `name`: an array, or for a structure its fields by name, which may be structures.

    Raises
    ------
    RecordingError  if the file is missing, damaged, of another level, has no such variable, or that is of another kind.
    """
    try:
        for kind, content in _variables(path):
            if kind == COMPRESSED:
                if _name_in(content) != name:
                    continue
                kind, content, _ = _element(_inflate(content))
            if kind == MATRIX:
                found, value = _matrix(content, name)
                if found == name:
                    return value
    except _OtherKind as problem:
        raise RecordingError(f"{path}: {problem}") from problem
    except (_Damaged, zlib.error) as problem:
        raise RecordingError(f"{path}: the MATLAB file is damaged or cut off: {problem}") from problem
    raise RecordingError(f"{path}: there is no variable {name!r} in it")


def variable_names(path: Path) -> list[str]:
    """What variables a file has. Raises RecordingError if the file is missing, damaged or of another level."""
    names = []
    try:
        for kind, content in _variables(path):
            name = _name_in(content) if kind == COMPRESSED else _name_of(content) if kind == MATRIX else None
            names += [] if name is None else [name]
    except (_Damaged, zlib.error) as problem:
        raise RecordingError(f"{path}: the MATLAB file is damaged or cut off: {problem}") from problem
    return names


def _variables(path: Path) -> Iterator[tuple[int, memoryview]]:
    """Type and content of each of a file's elements."""
    data = read_input(path, RecordingError, missing="the file is missing")
    if len(data) < 128 or data[124:128] != b"\x00\x01IM":
        raise RecordingError(f"{path}: not a MATLAB file of level 5, or cut off; save it in MATLAB with -v7")
    rest = memoryview(data)[128:]  # parts of it are no copies: there may be very many
    for _ in range(MAX_VARIABLES):
        if not rest:
            return
        kind, content, rest = _element(rest)
        yield kind, content
    if rest:
        raise _Damaged(f"it has more than {MAX_VARIABLES} variables")


def _element(data: memoryview) -> tuple[int, memoryview, memoryview]:
    """Type and content of the first element, and what follows it."""
    if len(data) < 8:
        raise _Damaged("it ends within an element")
    first, size = (int(x) for x in np.frombuffer(data, "<u4", 2))
    if first >> 16:
        kind, size, start, end = first & 0xFFFF, first >> 16, 4, 8
        if size > 4:
            raise _Damaged("a short element is longer than 4 bytes")
    else:
        kind, start = first, 8
        end = start + (size if kind == COMPRESSED else -(-size // 8) * 8)
    if start + size > len(data):
        raise _Damaged("it ends within an element")
    return kind, data[start : start + size], data[end:]


def _name_in(content: memoryview) -> str | None:
    """The name of the variable in a compressed element, of which only the head is inflated; None of anything else."""
    head = memoryview(zlib.decompressobj().decompress(content[: 2 * HEAD_BYTES], HEAD_BYTES))
    if len(head) < 8 or int(np.frombuffer(head, "<u4", 1)[0]) != MATRIX:
        return None
    return _name_of(head[8:])


def _name_of(matrix: memoryview) -> str:
    _, flags, rest = _element(matrix)
    _, second, rest = _element(rest)
    name = second if _is_opaque(flags) else _element(rest)[1]
    return bytes(name).decode("latin-1")


def _is_opaque(flags: memoryview) -> bool:
    return len(flags) == 8 and flags[0] == OPAQUE


def _inflate(content: memoryview) -> memoryview:
    stream = zlib.decompressobj()
    data = stream.decompress(content, MAX_BYTES)
    if not stream.eof:
        raise _Damaged("a compressed variable is incomplete or too large")
    return memoryview(data)


def _matrix(content: memoryview, wanted: str | None, depth: int = 0) -> tuple[str, Value]:
    """Name and value; the value of a variable that is not `wanted` (None: any) is left out."""
    _, flags, rest = _element(content)
    _, dimensions, rest = _element(rest)
    if _is_opaque(flags):
        text = bytes(dimensions).decode("latin-1")  # an object has no dimensions, its name comes first
        if wanted is not None and text != wanted:
            return text, np.empty(0)
        raise _OtherKind(f"{text or 'a field'} is an object of a class of MATLAB's; make it a structure before saving")
    _, name, rest = _element(rest)
    if len(flags) != 8 or len(dimensions) < 8 or len(dimensions) % 4:
        raise _Damaged("a variable's flags or dimensions are malformed")
    text = bytes(name).decode("latin-1")
    if wanted is not None and text != wanted:
        return text, np.empty(0)
    flag = int(np.frombuffer(flags, "<u4", 1)[0])
    shape = tuple(int(x) for x in np.frombuffer(dimensions, "<i4"))
    if min(shape) < 0 or len(shape) > MAX_DIMENSIONS:
        raise _Damaged("a dimension is negative, or there are too many")
    if flag & 0xFF == STRUCTURE:
        return text, _fields(rest, depth)
    if flag & 0xFF not in CLASS_DTYPES or flag & COMPLEX:
        raise _OtherKind(f"{text or 'a field'} is not a real numeric array")
    kind, values, _ = _element(rest)
    if kind not in VALUE_DTYPES or len(values) % np.dtype(VALUE_DTYPES[kind]).itemsize:
        raise _Damaged(f"the values of {text or 'a field'} are malformed")
    array = np.frombuffer(values, VALUE_DTYPES[kind])
    count = 1
    for length in shape:
        count *= length
    if array.size != count:
        raise _Damaged(f"{text or 'a field'} has {array.size} values instead of {count}")
    with np.errstate(invalid="ignore"):
        return text, array.astype(CLASS_DTYPES[flag & 0xFF]).reshape(shape, order="F")


def _fields(rest: memoryview, depth: int) -> dict[str, Any]:
    if depth >= MAX_DEPTH:
        raise _Damaged(f"more than {MAX_DEPTH} structures are in each other")
    _, length, rest = _element(rest)
    _, names, rest = _element(rest)
    width = int(np.frombuffer(length, "<i4", 1)[0]) if len(length) == 4 else 0
    if width < 1 or len(names) % width:
        raise _Damaged("a structure's field names are malformed")
    fields = {}
    for start in range(0, len(names), width):
        kind, content, rest = _element(rest)
        if kind != MATRIX:
            raise _Damaged("a structure's field is no matrix")
        if not content:  # what MATLAB writes for an empty field
            continue
        try:
            _, value = _matrix(content, None, depth + 1)
        except _OtherKind:
            continue
        fields[bytes(names[start : start + width]).split(b"\0")[0].decode("latin-1")] = value
    return fields
