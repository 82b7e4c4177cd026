"""Colour and depth images from files; one that is cut off, damaged or of the wrong kind is an error, never half an
image."""

import zlib
from pathlib import Path

import cv2
import numpy as np

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames import PinholeIntrinsics, RGBDFrame
from adagmm_o3d.errors import InputError, InputTypeError

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
COLOR_SUFFIXES = (".png", ".jpg", ".jpeg")


def inside(root: Path, relative: str, where: str) -> Path:
    """`root / relative`, which must stay inside the recording, links followed.

    Raises
    ------
    RecordingError  starting with `where`, if the path is absolute, climbs out, is a link that leads out, or is no path.
    """
    path = root / relative
    try:
        path.exists()
        outside = Path(relative).is_absolute() or not path.resolve().is_relative_to(root.resolve())
    except (OSError, ValueError) as problem:  # too long, a NUL byte, links in a circle
        raise RecordingError(f"{where}: {relative[:80]!r} is not a path that can be used: {problem}") from problem
    if outside:
        raise RecordingError(f"{where}: {relative!r} leads out of the recording folder {root}; move the file into it")
    return path


def read_color(path: Path) -> np.ndarray:
    """(H, W, 3) uint8 RGB from a PNG or JPEG file, as the sensor delivered it (an EXIF orientation is not applied)."""
    image = cv2.imdecode(_complete(path), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise RecordingError(f"{path}: the colour image cannot be decoded, it is damaged; get the file again")
    return np.ascontiguousarray(image[:, :, ::-1])


def read_depth(path: Path) -> np.ndarray:
    """(H, W) uint16 from a PNG file with one 16-bit channel."""
    image = cv2.imdecode(_complete(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise RecordingError(f"{path}: the depth image cannot be decoded, it is damaged; get the file again")
    if image.ndim != 2 or image.dtype != np.uint16:
        channels = 1 if image.ndim == 2 else image.shape[2]
        bits = image.dtype.itemsize * 8
        raise RecordingError(f"{path}: expected depth with one 16-bit channel, got {channels} of {bits} bits")
    return image


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of a PNG file, from its header."""
    header = _bytes(path, 33)  # the signature and the first chunk, IHDR, with its checksum
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
    fix_depth=None,
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


def checked_frame(path: Path, *values) -> RGBDFrame:
    """RGBDFrame(*values), where what is wrong becomes a RecordingError about `path`."""
    try:
        return RGBDFrame(*values)
    except (InputError, InputTypeError) as problem:
        raise RecordingError(f"{path}: frame {problem}") from problem


def _complete(path: Path) -> np.ndarray:
    """The file's bytes. Decoders fill what is cut off with grey, or print about it, so that is looked at here."""
    data = _bytes(path)
    if data.startswith(PNG_SIGNATURE):
        complete = _png_is_complete(data)
    elif data.startswith(b"\xff\xd8"):
        # In a JPEG's image data FF is followed by 00, so an end marker after the last start of scan is the real end.
        complete = data.find(b"\xff\xd9", data.rfind(b"\xff\xda")) >= 0
    else:
        raise RecordingError(f"{path}: expected a PNG or JPEG image, it is empty or something else")
    if not complete:
        raise RecordingError(f"{path}: the image is cut off or damaged; get the file again")
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


def _bytes(path: Path, count: int = -1) -> bytes:
    try:
        with open(path, "rb") as file:
            return file.read(count)
    except FileNotFoundError as problem:
        raise RecordingError(f"{path}: the image is missing") from problem
    except OSError as problem:
        raise RecordingError(f"{path}: cannot be read: {problem.strerror}") from problem
