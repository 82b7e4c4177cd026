"""Depth images in files other than PNG: NumPy .npy, PGM, TIFF and OpenEXR, told apart by their first bytes.

    .npy    one array of numbers, (H, W), or with one further axis of length 1
    .pgm    P5, 16 bits, the high byte first
    .tiff   one channel of 16 or 32 bits, decoded by OpenCV once all of its strips or tiles are there
    .exr    see exr_file.py

Source: NumPy's NEP 1; netpbm's pgm(5); TIFF 6.0.
"""

import math
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.exr_file import EXR_SIGNATURE, decode_exr
from adagmm_fusion.files.input_file import read_input

DEPTH_SUFFIXES = (".png", ".tiff", ".tif", ".exr", ".npy", ".pgm")
MAX_PIXELS = 1 << 26  # a file of a few bytes can claim to be an image of gigabytes
MAX_HEADER = 10_000

NPY_SIGNATURE = b"\x93NUMPY"
NPY_KEYS = {
    "descr": r"'([<>|=][uif][1248])'",
    "fortran_order": "(True|False)",
    "shape": r"\(([0-9, ]{0,60})\)",
}
TIFF_SIZES = {3: 2, 4: 4}


def read_array(path: Path) -> np.ndarray:
    """The array of a .npy file, float64, of any shape. Raises RecordingError naming the file if it is none."""
    data = read_input(path, RecordingError)
    try:
        if not data.startswith(NPY_SIGNATURE):
            raise ValueError("it is no .npy file")
        return _numpy(data).astype(np.float64)
    except (ValueError, TypeError, struct.error, OverflowError, MemoryError) as problem:
        raise RecordingError(f"{path}: the array cannot be used: {problem}") from problem


def decoder_of(first_bytes: bytes) -> Callable[[bytes, Path], np.ndarray] | None:
    """What decodes a file that starts so: a function of its bytes and its path, or None.

    That returns (H, W) uint16, float32 or float64, and raises RecordingError, naming the file, for what is damaged, has
    more than one channel or 8 bits.
    """
    for signature, decode in SIGNATURES.items():
        if first_bytes.startswith(signature):
            return lambda data, path: _checked(decode, data, path)
    return None


def _checked(decode: Callable[[bytes], np.ndarray], data: bytes, path: Path) -> np.ndarray:
    try:
        image = decode(data)
    except (ValueError, TypeError, struct.error, zlib.error, OverflowError, MemoryError) as problem:
        raise RecordingError(f"{path}: the depth image cannot be used: {problem}") from problem
    while image.ndim > 2 and 1 in (image.shape[0], image.shape[-1]):
        image = image[0] if image.shape[0] == 1 else image[..., 0]
    if image.ndim != 2 or image.size == 0 or image.dtype.itemsize < 2 or image.dtype.kind not in "uif":
        shape, dtype = "x".join(map(str, image.shape)), image.dtype
        raise RecordingError(f"{path}: expected depth with one channel of 16 or more bits, got {shape} {dtype}")
    if image.dtype.kind in "ui":
        whole = image.min() >= 0 and image.max() <= np.iinfo(np.uint16).max
        return image.astype(np.uint16 if whole else np.float64)
    return image.astype(np.float64 if image.dtype.itemsize == 8 else np.float32)


def _limited(width: int, height: int) -> None:
    if not 0 < width * height <= MAX_PIXELS:
        raise ValueError(f"it says that it has {width}x{height} pixels")


def _numpy(data: bytes) -> np.ndarray:
    # NumPy's own reader lets Python parse the header, which fails in all its ways.
    form, start = ("<H", 10) if data[6:7] == b"\1" else ("<I", 12)
    (length,) = struct.unpack_from(form, data, 8)
    header = data[start : start + min(length, MAX_HEADER)].decode("latin-1")
    found = [re.search(rf"'{key}': *{value}", header) for key, value in NPY_KEYS.items()]
    if not all(found):
        raise ValueError(f"expected an array of numbers, its header is {header[:60].strip()!r}")
    dtype, by_columns = np.dtype(found[0][1]), found[1][1] == "True"
    shape = [int(word) for word in found[2][1].replace(",", " ").split()]
    count = math.prod(shape)
    if count > MAX_PIXELS or len(data) - start - length != count * dtype.itemsize:
        raise ValueError("it is cut off, or too large")
    values = np.frombuffer(data, dtype, count, start + length)
    return values.reshape(shape, order="F" if by_columns else "C").astype(dtype.newbyteorder("="))


def _pgm(data: bytes) -> np.ndarray:
    words: list[int] = []
    at = 2
    while len(words) < 3:
        line = data[at : at + 1]
        if line == b"#":
            at = data.index(b"\n", at)
        elif line.isspace():
            at += 1
        else:
            end = at
            while data[end : end + 1].isdigit() and end - at < 9:
                end += 1
            words.append(int(data[at:end]))
            at = end
    width, height, highest = words
    _limited(width, height)
    if not 255 < highest < 65536:
        raise ValueError(f"expected 16 bits, its highest value is {highest}")
    if len(data) < at + 1 + 2 * width * height:
        raise ValueError("it is cut off")
    return np.frombuffer(data, ">u2", width * height, at + 1).reshape(height, width).astype(np.uint16)


def _tiff(data: bytes) -> np.ndarray:
    order = "<" if data[:2] == b"II" else ">"
    (directory,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, directory)
    tags: dict[int, tuple[int, ...]] = {}
    for i in range(count):
        tag, kind, length = struct.unpack_from(f"{order}HHI", data, directory + 2 + 12 * i)
        if tag not in (256, 257, 273, 279, 324, 325) or kind not in TIFF_SIZES:
            continue
        at = directory + 2 + 12 * i + 8
        if length * TIFF_SIZES[kind] > 4:
            (at,) = struct.unpack_from(f"{order}I", data, at)
        if at + length * TIFF_SIZES[kind] > len(data):
            raise ValueError("it is cut off")
        tags[tag] = struct.unpack_from(f"{order}{length}{'H' if kind == 3 else 'I'}", data, at)
    if not (tags.get(256) and tags.get(257)):
        raise ValueError("it does not say its size")
    _limited(tags[256][0], tags[257][0])
    starts, lengths = (tags.get(273) or tags.get(324) or (), tags.get(279) or tags.get(325) or ())
    if not starts or len(starts) != len(lengths):
        raise ValueError("it does not say where its pixels are")
    if any(start + length > len(data) for start, length in zip(starts, lengths, strict=True)):
        raise ValueError("it is cut off")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise ValueError("OpenCV cannot decode it")
    return image


SIGNATURES: dict[bytes, Callable[[bytes], np.ndarray]] = {
    NPY_SIGNATURE: _numpy,
    b"P5": _pgm,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    EXR_SIGNATURE: decode_exr,
}
