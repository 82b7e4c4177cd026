"""Colour and depth images from files; one that is cut off, damaged or of the wrong kind is an error, never half an
image."""

import struct
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.depth_files import MAX_PIXELS, decoder_of
from adagmm_fusion.files.input_file import read_input
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_o3d.errors import InputError, InputTypeError

Item = TypeVar("Item")
Read = TypeVar("Read")

MISSING = "the image is missing"
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")
# JPEG markers: those that no length follows, and those that start a frame and state the image's size.
JPEG_ALONE = (0x01, *range(0xD0, 0xDA))
JPEG_FRAMES = (*range(0xC0, 0xC4), *range(0xC5, 0xC8), *range(0xC9, 0xCC), *range(0xCD, 0xD0))


def inside(root: Path, relative: str, where: str) -> Path:
    """`root / relative`, which must stay inside the recording, links followed.

    Raises
    ------
    RecordingError  starting with `where`, if the path leads out, as itself or as a link, or is no path.
    """
    path = root / relative
    try:
        if "\\" in relative and not path.exists():  # written on Windows
            relative = relative.replace("\\", "/")
            path = root / relative
        path.exists()
        outside = not path.resolve().is_relative_to(root.resolve())
    except (OSError, RuntimeError, ValueError) as problem:  # too long, a NUL byte, links in a circle
        raise RecordingError(f"{where}: {relative[:80]!r} is not a path that can be used: {problem}") from problem
    if outside:
        raise RecordingError(f"{where}: {relative!r} leads out of the recording folder {root}; move the file into it")
    return path


def first_readable(items: Iterable[Item], read: Callable[[Item], Read]) -> Read:
    """What `read` makes of the first of the items that can be read; the others say themselves what is wrong with them.

    Raises
    ------
    RecordingError  of the first item, if none can be read.    ValueError  if there is none.
    """
    first: RecordingError | None = None
    for item in items:
        try:
            return read(item)
        except RecordingError as problem:
            first = first or problem
    raise first or ValueError("items: expected one at least, got none")


def read_color(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB from a PNG or JPEG file, as the sensor delivered it (an EXIF orientation is not applied)."""
    return decoded_color(read_input(path, RecordingError, missing=MISSING), path)


def decoded_color(data: bytes, path: Path) -> np.ndarray:
    """`read_color` of a file's bytes; `path` is what messages name."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = _decoded(data, path, flags)
    if image.dtype != np.uint8:
        bits = image.dtype.itemsize * 8
        raise RecordingError(f"{path}: expected colours of 8 bits, got {bits}; is it the depth image?")
    return np.ascontiguousarray(image[:, :, ::-1])


def read_depth(path: Path) -> np.ndarray:
    """(H, W) uint16 from a PNG file with one 16-bit channel; also float32 or float64 from one of `depth_files`."""
    return decoded_depth(read_input(path, RecordingError, missing=MISSING), path)


def decoded_depth(data: bytes, path: Path) -> np.ndarray:
    """`read_depth` of a file's bytes; `path` is what messages name."""
    if (decode := decoder_of(data)) is not None:
        return decode(data, path)
    image = _decoded(data, path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != np.uint16:
        channels = 1 if image.ndim == 2 else image.shape[2]
        bits = image.dtype.itemsize * 8
        hint = "; is it the colour image, or a preview of the depth?" if bits == 8 else ""
        raise RecordingError(f"{path}: expected depth with one 16-bit channel, got {channels} of {bits} bits{hint}")
    return image


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of a PNG file, from its header; of other depth files, from all of it."""
    if decoder_of(read_input(path, RecordingError, count=8, missing=MISSING)) is not None:
        height, width = read_depth(path).shape
        return width, height
    header = read_input(
        path, RecordingError, count=33, missing=MISSING
    )  # the signature and the first chunk, IHDR, with its checksum
    checksum = int.from_bytes(header[29:], "big")
    if len(header) < 33 or not header.startswith(PNG_SIGNATURE) or zlib.crc32(header[12:29]) != checksum:
        raise RecordingError(f"{path}: expected a PNG image, it is something else or damaged")
    return int.from_bytes(header[16:20], "big"), int.from_bytes(header[20:24], "big")


def load_frame(
    name: str,
    sensor: str,
    color_path: Path,
    depth_path: Path,
    intrinsics: PinholeIntrinsics,
    depth_scale: float,
    timestamp: float | None = None,
    fix_depth: Callable[[np.ndarray], np.ndarray] | None = None,
) -> RGBDFrame:
    """The frame of two image files; `fix_depth` maps the stored depth values to what `depth_scale` is about.

    Raises
    ------
    RecordingError  naming the file, if an image is missing, damaged, or does not fit the other one or the intrinsics.
    """
    color, depth = read_color(color_path), read_depth(depth_path)
    if fix_depth is not None:
        depth = fix_depth(depth)
    return checked_frame(depth_path, name, color, depth, intrinsics, depth_scale, sensor, timestamp)


def checked_frame(path: Path, *values: Any) -> RGBDFrame:
    """RGBDFrame(*values), where what is wrong becomes a RecordingError about `path`."""
    try:
        return RGBDFrame(*values)
    except (InputError, InputTypeError) as problem:
        raise RecordingError(f"{path}: frame {problem}") from problem


def _decoded(data: bytes, path: Path, flags: int) -> np.ndarray:
    try:
        image = cv2.imdecode(_complete(data, path), flags)
    except cv2.error:  # for what it does not take at all
        image = None
    if image is None:
        raise RecordingError(f"{path}: the image cannot be decoded, it is damaged; get the file again")
    return image


def _complete(data: bytes, path: Path) -> np.ndarray:
    """The bytes. Decoders fill what is cut off with grey, or print about it, so that is looked at here."""
    if data.startswith(PNG_SIGNATURE):
        complete = data[12:16] == b"IHDR" and _png_is_complete(data)
        width, height = struct.unpack(">II", data[16:24]) if complete else (0, 0)
    elif data.startswith(b"\xff\xd8"):
        # In a JPEG's image data FF is followed by 00, so an end marker after the last start of scan is the real end.
        complete = data.find(b"\xff\xd9", data.rfind(b"\xff\xda")) >= 0
        width, height = _jpeg_size(data)
    else:
        raise RecordingError(f"{path}: expected a PNG or JPEG image, it is empty or something else")
    if not complete or width * height == 0:
        raise RecordingError(f"{path}: the image is cut off or damaged; get the file again")
    if width * height > MAX_PIXELS:
        wanted = f"at most {MAX_PIXELS >> 20} megapixels"
        raise RecordingError(f"{path}: expected an image of {wanted}, it says that it has {width}x{height} pixels")
    return np.frombuffer(data, np.uint8)


def _png_is_complete(data: bytes) -> bool:
    """Every chunk is there in full, with the right checksum, up to the end chunk."""
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        end = at + 8 + length
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """(width, height) of the largest frame that its segments tell of; (0, 0) of none."""
    width = height = 0
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        marker = data[at + 1]
        if marker in JPEG_FRAMES:
            rows, columns = struct.unpack(">HH", data[at + 5 : at + 9])
            width, height = max(width, columns), max(height, rows)
        fill = marker == 0xFF  # a marker may come after any number of these
        at += 1 if fill else 2 if marker in JPEG_ALONE else 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return width, height
