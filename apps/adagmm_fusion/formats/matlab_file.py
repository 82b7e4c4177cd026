"""MATLAB .mat files, level 5 (what `save` writes up to version 7): real numeric arrays, and structures of them.

    file        128 bytes header (the last four: version 0x0100, "IM"), then elements
    element     uint32 type, uint32 size, data, padded to 8 bytes; or, up to 4 bytes, uint16 type, uint16 size, 4 bytes
    compressed  an element of type 15: zlib data that is one element, unpadded
    matrix      an element of type 14 made of elements: flags (its first byte the class), dimensions (int32), name, and
                a numeric class: the values column by column, in a type that may be smaller than the class;
                a structure: the length of a field's name, the names one behind the other, one matrix a field

Read here because SciPy's reader can crash the process on a damaged file. Source: MathWorks, MAT-File Format, level 5.
"""

import zlib
from pathlib import Path

import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import read_input

VALUE_DTYPES = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 9: "<f8", 12: "<i8", 13: "<u8"}
CLASS_DTYPES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
STRUCTURE, MATRIX, COMPRESSED, COMPLEX = 2, 14, 15, 0x0800
MAX_BYTES = 1 << 26  # of the variable that is read; far more than an image
HEAD_BYTES = 1024  # a variable's flags, dimensions and name are in these
MAX_VARIABLES = 10_000
MAX_DIMENSIONS = 8


class _Damaged(Exception):
    """What is wrong with the bytes."""


def read_variable(path: Path, name: str) -> np.ndarray | dict[str, np.ndarray]:
    """The variable `name`: an array, or for a structure its fields by name.

    Raises
    ------
    RecordingError  if the file is missing, damaged, of another level, has no such variable, or that is of another kind.
    """
    data = read_input(path, RecordingError, missing="the file is missing")
    if len(data) < 128 or data[124:128] != b"\x00\x01IM":
        raise RecordingError(f"{path}: not a MATLAB file of level 5, or cut off; save it in MATLAB with -v7")
    try:
        rest = memoryview(data)[128:]  # parts of it are no copies: there may be very many
        for _ in range(MAX_VARIABLES):
            if not rest:
                break
            kind, content, rest = _element(rest)
            if kind == COMPRESSED:
                if _name_in(content) != name:
                    continue
                kind, content, _ = _element(_inflate(content))
            if kind == MATRIX:
                found, value = _matrix(content, name)
                if found == name:
                    return value
        if rest:
            raise _Damaged(f"it has more than {MAX_VARIABLES} variables")
    except (_Damaged, zlib.error) as problem:
        raise RecordingError(f"{path}: the MATLAB file is damaged or cut off: {problem}") from problem
    raise RecordingError(f"{path}: there is no variable {name!r} in it")


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
    _, _, rest = _element(head[8:])
    _, _, rest = _element(rest)
    return bytes(_element(rest)[1]).decode("latin-1")


def _inflate(content: memoryview) -> memoryview:
    stream = zlib.decompressobj()
    data = stream.decompress(content, MAX_BYTES)
    if not stream.eof:
        raise _Damaged("a compressed variable is incomplete or too large")
    return memoryview(data)


def _matrix(content: memoryview, wanted: str | None) -> tuple[str, np.ndarray | dict[str, np.ndarray]]:
    """Name and value; the value of a variable that is not `wanted` (None: any) is left out."""
    _, flags, rest = _element(content)
    _, dimensions, rest = _element(rest)
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
        return text, _fields(rest)
    if flag & 0xFF not in CLASS_DTYPES or flag & COMPLEX:
        raise _Damaged(f"{text or 'a field'} is not a real numeric array")
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


def _fields(rest: memoryview) -> dict[str, np.ndarray]:
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
        _, value = _matrix(content, None)
        if not isinstance(value, np.ndarray):
            raise _Damaged("a structure is in a structure")
        fields[bytes(names[start : start + width]).split(b"\0")[0].decode("latin-1")] = value
    return fields
