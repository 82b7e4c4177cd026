"""OpenEXR files of one part of scan lines, uncompressed or compressed as RLE, ZIPS or ZIP.

    76 2f 31 01, uint32 flags   then attributes: name, 0, type, 0, int32 size, value; a 0 ends them
    channels                    name, 0, int32 type (0 uint, 1 half, 2 float), 4 bytes, int32 steps in x and y; a 0 ends
    offsets                     uint64 of each block of scan lines: int32 first row, int32 size, data

Of several channels the depth is the one whose name ends in Z, depth, D, V, Y or R. OpenCV's builds do not read them.
Source: OpenEXR File Layout.
"""

import struct
import zlib

import numpy as np

EXR_SIGNATURE = b"\x76\x2f\x31\x01"
EXR_DTYPES = {0: "<u4", 1: "<f2", 2: "<f4"}
EXR_LINES = {0: 1, 1: 1, 2: 1, 3: 16}  # of one block, by compression: none, RLE, ZIPS, ZIP
EXR_DEPTH_CHANNELS = ("z", "depth", "d", "v", "y", "r")


def decode_exr(data: bytes, max_pixels: int = 1 << 26) -> np.ndarray:
    """(H, W) float16, float32 or uint32, the depth channel.

    Raises
    ------
    ValueError, struct.error, zlib.error  if it is damaged, or more than this reads.
    """
    (flags,) = struct.unpack_from("<I", data, 4)
    if flags & ~0x4FF:  # a long name may be anywhere
        raise ValueError("tiled, deep and multi-part files are not read; save it as scan lines")
    attributes, at = {}, 8
    while data[at : at + 1] != b"\0":
        name_end = data.index(b"\0", at)
        type_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", data, type_end + 1)
        if size < 0 or type_end + 5 + size > len(data):
            raise ValueError("it is cut off")
        attributes[data[at:name_end]] = data[type_end + 5 : type_end + 5 + size]
        at = type_end + 5 + size
    if not all(name in attributes for name in (b"channels", b"compression", b"dataWindow")):
        raise ValueError("its header is not whole")
    x0, y0, x1, y1 = struct.unpack("<4i", attributes[b"dataWindow"])
    width, height, compression = x1 - x0 + 1, y1 - y0 + 1, attributes[b"compression"][0]
    if not 0 < width * height <= max_pixels:
        raise ValueError(f"it says that it has {width}x{height} pixels")
    if compression not in EXR_LINES:
        raise ValueError(f"compression {compression} is not read; save it with ZIP compression")
    dtype, name = _exr_channels(attributes[b"channels"], width)
    blocks = -(-height // EXR_LINES[compression])
    image = np.empty((height, width), dtype[name].base)
    for start in struct.unpack_from(f"<{blocks}Q", data, at + 1):
        y, size = struct.unpack_from("<2i", data, start)
        row = y - y0
        lines = min(EXR_LINES[compression], height - row)
        if row < 0 or lines < 1 or size < 0 or start + 8 + size > len(data):
            raise ValueError("it is cut off")
        block = _exr_block(data[start + 8 : start + 8 + size], compression, lines * dtype.itemsize)
        image[row : row + lines] = np.frombuffer(block, dtype, lines)[name]
    return image


def _exr_channels(listed: bytes, width: int) -> tuple[np.dtype, str]:
    """The layout of one scan line, and the channel that is the depth."""
    fields: list[tuple[str, str, int]] = []
    at = 0
    while listed[at : at + 1] not in (b"\0", b""):
        end = listed.index(b"\0", at)
        kind, _, x_step, y_step = struct.unpack_from("<iIii", listed, end + 1)
        if kind not in EXR_DTYPES or (x_step, y_step) != (1, 1):
            raise ValueError("it has channels of another resolution or type")
        fields.append((listed[at:end].decode("latin-1"), EXR_DTYPES[kind], width))
        at = end + 17
    by_part = {name.rpartition(".")[2].lower(): name for name, *_ in reversed(fields)}
    chosen = next((by_part[part] for part in EXR_DEPTH_CHANNELS if part in by_part), None)
    if len(fields) == 1:
        chosen = fields[0][0]
    if chosen is None:
        raise ValueError(f"expected a channel Z or depth, got {', '.join(name for name, *_ in fields) or 'none'}")
    return np.dtype([(name, kind, (count,)) for name, kind, count in fields]), chosen


def _exr_block(data: bytes, compression: int, size: int) -> bytes:
    if len(data) == size:  # what does not become smaller is stored as it is
        return data
    if compression == 0:
        raise ValueError("it is cut off")
    packed = _unpacked_runs(data, size) if compression == 1 else zlib.decompressobj().decompress(data, size)
    if len(packed) != size:
        raise ValueError("it is cut off")
    # Differences to the byte before, and before that the even bytes in front of the odd ones.
    values = np.frombuffer(packed, np.uint8).astype(np.int64)
    values[1:] -= 128
    values = (np.cumsum(values) & 0xFF).astype(np.uint8)
    mixed = np.empty(size, np.uint8)
    mixed[0::2], mixed[1::2] = values[: (size + 1) // 2], values[(size + 1) // 2 :]
    return mixed.tobytes()


def _unpacked_runs(data: bytes, size: int) -> bytes:
    out, at = bytearray(), 0
    while at < len(data) and len(out) <= size:
        count = data[at] - 256 if data[at] > 127 else data[at]
        if count < 0:
            out += data[at + 1 : at + 1 - count]
            at += 1 - count
        else:
            out += data[at + 1 : at + 2] * (count + 1)
            at += 2
    return bytes(out)
