"""Matroska (.mkv) files: their tracks, tags and attachments, and where each block is. Nothing is decoded.

A file is elements: an id, a size, both of variable length, and content, which for some is elements again. Those are
entered here without looking at where they end, which a file that was not closed does not say. Source: RFC 8794, 9559.
"""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.input_file import MAX_BYTES, check_input

EBML, SEGMENT, INFO, TRACKS, TAGS, ATTACHMENTS, CLUSTER = (
    0x1A45DFA3, 0x18538067, 0x1549A966, 0x1654AE6B, 0x1254C367, 0x1941A469, 0x1F43B675,
)  # fmt: skip
TRACK_ENTRY, VIDEO, TAG, SIMPLE_TAG, ATTACHED_FILE, BLOCK_GROUP = 0xAE, 0xE0, 0x7373, 0x67C8, 0x61A7, 0xA0
ENTERED = (
    SEGMENT,
    INFO,
    TRACKS,
    TAGS,
    ATTACHMENTS,
    CLUSTER,
    TRACK_ENTRY,
    VIDEO,
    TAG,
    SIMPLE_TAG,
    ATTACHED_FILE,
    BLOCK_GROUP,
)
TIMESTAMP_SCALE, TRACK_NUMBER, TRACK_NAME, CODEC_PRIVATE, WIDTH, HEIGHT = 0x2AD7B1, 0xD7, 0x536E, 0x63A2, 0xB0, 0xBA
TAG_NAME, TAG_STRING, FILE_NAME, FILE_DATA = 0x45A3, 0x4487, 0x466E, 0x465C
TIMESTAMP, SIMPLE_BLOCK, BLOCK = 0xE7, 0xA3, 0xA1
LACING = 0x06
MAX_VALUE = 1 << 20  # bytes, of a number, a name or a text


@dataclass
class Track:
    """One track: `codec` is what a bitmap's header calls its format, such as MJPG."""

    number: int = 0
    name: str = ""
    codec: str = ""
    width: int = 0
    height: int = 0
    blocks: list[tuple[int, int, int]] = field(default_factory=list)  # time [ns], start in the file, size


class MatroskaFile:
    """`tracks` by name, `tags` and `attachments` by name.

    Raises
    ------
    RecordingError  if the file is missing or none of Matroska. What is cut off in it is left out.
    """

    def __init__(self, path: Path) -> None:
        check_input(path, RecordingError)
        self.path = path
        self.tags: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        if not _is_matroska(path):
            raise RecordingError(f"{path}: expected a Matroska file (.mkv), it is something else or damaged")
        tracks: list[Track] = []
        scale, cluster_time, name = 1_000_000, 0, ""
        with path.open("rb") as file:
            for kind, at, size in _elements(file, path.stat().st_size):
                if kind == TRACK_ENTRY:
                    tracks.append(Track())
                elif kind in (SIMPLE_BLOCK, BLOCK):
                    _add_block(file, at, size, tracks, cluster_time, scale)
                elif kind == FILE_DATA and size <= MAX_BYTES:
                    self.attachments[name] = file.read(size)
                elif size <= MAX_VALUE:
                    value = file.read(size)
                    number, text = int.from_bytes(value[:8], "big"), value.rstrip(b"\0").decode("utf-8", "replace")
                    if kind == TIMESTAMP_SCALE:
                        scale = number
                    elif kind == TIMESTAMP:
                        cluster_time = number
                    elif kind in (TAG_NAME, FILE_NAME):
                        name = text
                    elif kind == TAG_STRING:
                        self.tags[name] = text
                    elif tracks:
                        _describe(tracks[-1], kind, number, text, value)
        self.tracks = {track.name: track for track in tracks}

    def block(self, track: Track, index: int) -> bytes:
        """The content of a track's block."""
        _, start, size = track.blocks[index]
        with self.path.open("rb") as file:
            file.seek(start)
            return file.read(size)


def _is_matroska(path: Path) -> bool:
    """Whether a file starts as Matroska's do. It may be larger than what is read whole elsewhere."""
    with path.open("rb") as file:
        return int.from_bytes(file.read(4), "big") == EBML


def _elements(file: BinaryIO, end: int) -> Iterator[tuple[int, int, int]]:
    """(id, start of the content, its size); the caller may read it, and the file is then put behind it."""
    at = 0
    while at < end:
        file.seek(at)
        kind = _variable(file, keep_marker=True)
        size = _variable(file, keep_marker=False)
        if kind is None or size is None:
            return
        start = file.tell()
        if kind[0] in ENTERED:
            yield kind[0], start, 0
            at = start
            continue
        if start + size[0] > end:  # cut off
            return
        yield kind[0], start, size[0]
        at = start + size[0]


def _variable(file: BinaryIO, *, keep_marker: bool) -> tuple[int] | None:
    """A number whose first byte's leading zeros tell its length."""
    first = file.read(1)
    if not first or first == b"\0":
        return None
    length = 9 - first[0].bit_length()
    rest = file.read(length - 1)
    if len(rest) != length - 1:
        return None
    value = first[0] if keep_marker else first[0] & ((1 << (8 - length)) - 1)
    return (int.from_bytes(bytes([value]) + rest, "big"),)


def _add_block(file: BinaryIO, at: int, size: int, tracks: list[Track], cluster_time: int, scale: int) -> None:
    number = _variable(file, keep_marker=False)
    head = file.read(3)
    if number is None or len(head) < 3 or head[2] & LACING:
        return
    time = (cluster_time + int.from_bytes(head[:2], "big", signed=True)) * scale
    content = file.seek(0, os.SEEK_CUR)
    for track in tracks:
        if track.number == number[0] and content <= at + size:
            track.blocks.append((time, content, at + size - content))


def _describe(track: Track, kind: int, number: int, text: str, value: bytes) -> None:
    if kind == TRACK_NUMBER:
        track.number = number
    elif kind == TRACK_NAME:
        track.name = text
    elif kind == WIDTH:
        track.width = number
    elif kind == HEIGHT:
        track.height = number
    elif kind == CODEC_PRIVATE and len(value) >= 20:  # a BITMAPINFOHEADER
        track.codec = value[16:20].decode("latin-1")
