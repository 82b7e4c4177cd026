"""Depth images in other files than PNG, written by OpenCV, NumPy and by hand as the formats' documents say."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.image_files import image_size, read_depth

RNG = np.random.default_rng(3)
WHOLE = RNG.integers(0, 5000, (35, 18)).astype(np.uint16)
METRES = (WHOLE / 1000.0).astype(np.float32)


def exr(image: np.ndarray, compression: int, names=(b"Z",)) -> bytes:
    """An OpenEXR file of scan lines: compression 0 none, 1 RLE, 2 ZIPS, 3 ZIP; all but the last channel are zero."""
    height, width = image.shape
    kind = {"f2": 1, "f4": 2, "u4": 0}[image.dtype.str[1:]]
    channels = b"".join(name + b"\0" + struct.pack("<iIii", kind, 0, 1, 1) for name in names) + b"\0"
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = {
        b"channels": (b"chlist", channels),
        b"compression": (b"compression", bytes([compression])),
        b"dataWindow": (b"box2i", box),
        b"displayWindow": (b"box2i", box),
        b"lineOrder": (b"lineOrder", b"\0"),
    }
    header = b"\x76\x2f\x31\x01" + struct.pack("<I", 2)
    for name, (type_name, value) in attributes.items():
        header += name + b"\0" + type_name + b"\0" + struct.pack("<i", len(value)) + value
    header += b"\0"
    lines = 16 if compression == 3 else 1
    blocks = []
    for row in range(0, height, lines):
        raw = b"".join(b"\0" * (line.nbytes * (len(names) - 1)) + line.tobytes() for line in image[row : row + lines])
        mixed = np.frombuffer(raw[0::2] + raw[1::2], np.uint8).astype(int)
        differences = np.concatenate((mixed[:1], np.diff(mixed) + 128)).astype(np.uint8).tobytes()
        packed = zlib.compress(differences) if compression > 1 else runs(differences) if compression else raw
        blocks.append(struct.pack("<ii", row, min(len(packed), len(raw))) + (packed if len(packed) < len(raw) else raw))
    offsets, at = b"", len(header) + 8 * len(blocks)
    for block in blocks:
        offsets += struct.pack("<Q", at)
        at += len(block)
    return header + offsets + b"".join(blocks)


def runs(data: bytes) -> bytes:
    """OpenEXR's run lengths: n, byte for n + 1 equal ones; -n and n bytes as they are."""
    out, at = b"", 0
    while at < len(data):
        end = at + 1
        while end < len(data) and data[end] == data[at] and end - at < 127:
            end += 1
        out += bytes([end - at - 1, data[at]]) if end - at > 1 else bytes([255, data[at]])
        at = end
    return out


def pgm(image: np.ndarray, comment: str = "") -> bytes:
    return f"P5\n{comment}{image.shape[1]} {image.shape[0]}\n65535\n".encode() + image.astype(">u2").tobytes()


def tiff(image: np.ndarray) -> bytes:
    return cv2.imencode(".tiff", image)[1].tobytes()


def npy(array: np.ndarray) -> bytes:
    import io

    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


SMOOTH = np.repeat(METRES[:, :1], 18, axis=1)
SAMPLES = {
    "npy of metres": (npy(METRES), METRES),
    "npy by columns": (npy(np.asfortranarray(METRES)), METRES),
    "npy of int64 with a third axis": (npy(WHOLE.astype(np.int64)[..., None]), WHOLE),
    "npy, the high byte first": (npy(WHOLE.astype(">u2")), WHOLE),
    "npy of half precision": (npy(METRES.astype(np.float16)), METRES.astype(np.float16).astype(np.float32)),
    "pgm": (pgm(WHOLE), WHOLE),
    "pgm with a comment": (pgm(WHOLE, "# by hand\n"), WHOLE),
    "tiff of 16 bits": (tiff(WHOLE), WHOLE),
    "tiff of metres": (tiff(METRES), METRES),
    **{f"exr {name}": (exr(METRES, number), METRES) for number, name in enumerate(("raw", "rle", "zips", "zip"))},
    **{f"smooth exr {name}": (exr(SMOOTH, number), SMOOTH) for number, name in ((1, "rle"), (2, "zips"), (3, "zip"))},
    "exr of three channels": (exr(METRES, 3, (b"B", b"G", b"ViewLayer.Depth.Z")), METRES),
}


@pytest.mark.parametrize("name", SAMPLES)
def test_what_was_written_is_read(tmp_path, name):
    data, expected = SAMPLES[name]
    path = tmp_path / "depth"
    path.write_bytes(data)
    depth = read_depth(path)
    assert depth.dtype == expected.dtype and np.array_equal(depth, expected)
    assert image_size(path) == (18, 35)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_file_that_is_cut_off_is_never_half_an_image(tmp_path, name):
    data, expected = SAMPLES[name]
    path = tmp_path / "depth"
    for length in range(0, len(data) - 1, 7):
        path.write_bytes(data[:length])
        try:
            depth = read_depth(path)
        except RecordingError as problem:
            assert str(path) in str(problem)
        else:  # what is cut off is not the image
            assert np.array_equal(depth, expected) and length > 0.9 * len(data)


@pytest.mark.parametrize("name", SAMPLES)
def test_damaged_bytes_are_an_error_or_an_image(tmp_path, name):
    data, _ = SAMPLES[name]
    path = tmp_path / "depth"
    for _ in range(100):
        damaged = bytearray(data)
        for at in RNG.integers(0, min(len(data), 400), 2):
            damaged[at] = RNG.integers(0, 256)
        path.write_bytes(damaged)
        try:
            assert read_depth(path).ndim == 2
        except RecordingError as problem:
            assert str(path) in str(problem) and "\n" not in str(problem)


@pytest.mark.parametrize(
    ("data", "match"),
    [
        (npy(np.zeros((4, 5, 3), np.float32)), "expected depth with one channel of 16 or more bits, got 4x5x3 float32"),
        (npy(np.zeros((4, 5), np.uint8)), "got 4x5 uint8"),
        (npy(np.zeros((4, 5), complex)), "expected an array of numbers"),
        (npy(np.zeros((0, 5))), "got 0x5 float64"),
        (tiff(np.zeros((4, 5, 3), np.uint8)), "got 4x5x3 uint8"),
        (b"P5\n4 5\n255\n" + b"\0" * 20, "expected 16 bits, its highest value is 255"),
        (b"P5\n99999 99999\n65535\n", "it says that it has 99999x99999 pixels"),
        (exr(METRES, 0, (b"A", b"B")), "expected a channel Z or depth, got A, B"),
        (exr(METRES, 0).replace(b"compression\0\1\0\0\0\0", b"compression\0\1\0\0\0\4"), "compression 4 is not read"),
    ],
)
def test_what_is_no_depth_is_said(tmp_path, data, match):
    (tmp_path / "depth").write_bytes(data)
    with pytest.raises(RecordingError, match=match):
        read_depth(tmp_path / "depth")


def test_arrays_of_objects_are_not_unpickled(tmp_path):
    np.save(tmp_path / "depth.npy", np.array([{1}], dtype=object), allow_pickle=True)
    with pytest.raises(RecordingError, match="expected an array of numbers"):
        read_depth(tmp_path / "depth.npy")
