"""The readers against damage of every kind: an error of ours or success, never another exception, a hang, or memory
without bound.

    ADAGMM_FUZZ_EXAMPLES=20000 pytest tests/fusion/test_reader_fuzz.py

tries so many of each kind, other ones every time; without it the few that are tried are always the same.
"""

import contextlib
import itertools
import os
import resource
import signal
import tempfile
import zlib
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reader_cases import NEEDS_RIG, WRITERS, files_of, read_everything, rig_of, write_files

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.files.image_files import image_size, read_color, read_depth
from adagmm_fusion.files.strict_yaml import read_yaml
from adagmm_fusion.formats.matlab_file import read_variable
from adagmm_fusion.recordings.opening import FORMATS
from adagmm_fusion.rigs.importing import read_camera, read_stereo_pose
from adagmm_fusion.rigs.rig import load_rig
from adagmm_o3d.errors import AdaGMMError, InputError

LONG = os.environ.get("ADAGMM_FUZZ_EXAMPLES")
HANG_S = 60
MEMORY_BYTES = 1 << 30
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# What stands in text files where something sensible should.
ABSURD = (
    "", "0", "-1", "1e308", "-1e308", "1e-308", "1e999", "nan", "inf", "999999999999999999999", "9" * 5000, "0x10",
    "1_0", "1.5.2", "true", "null", "~", "٣", "\ud7ff", '"\\uD800"', '"\\UFFFFFFFF"', '"\\x1b[2J"', "&a", "*a",
    "!!python/object:os.system", "[", "]", "{", "}", "[" * 3000, ":", "- ", "#", "%YAML 9.9", "---\n", "\x00",
    "\x1b[2J",
    "../../../../etc/passwd", "/etc/passwd", "/dev/zero", ".", "..", "a" * 300, "depth/", "\n", "metre", "millimetre",
)  # fmt: skip


def fuzzing(examples: int):
    quiet = [HealthCheck.too_slow, HealthCheck.data_too_large]
    if LONG:
        return settings(max_examples=int(LONG), derandomize=False, suppress_health_check=quiet)
    return settings(max_examples=examples, suppress_health_check=quiet)


@contextlib.contextmanager
def bounded(memory: int | None = MEMORY_BYTES):
    """The process must not grow by more than `memory` bytes within, nor take longer than HANG_S."""

    def hung(*_):
        raise AssertionError(f"still busy after {HANG_S} s")

    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGALRM, hung)
    resource.setrlimit(resource.RLIMIT_AS, (soft if memory is None else used + memory, hard))
    signal.setitimer(signal.ITIMER_REAL, HANG_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGALRM, before)


needs_limits = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is limited the Linux way")
pytestmark = [needs_limits, pytest.mark.slow]


# Damage. Every kind takes the files and numbers that it makes places of, and changes the files.


def _place(data: bytes, number: int) -> int:
    return number % (len(data) + 1)


def cut(files, name, a, b, value):
    files[name] = files[name][: _place(files[name], a)]


def flip(files, name, a, b, value):
    data = bytearray(files[name])
    if data:
        data[a % len(data)] ^= b % 255 + 1
    files[name] = bytes(data)


def insert(files, name, a, b, value):
    at = _place(files[name], a)
    files[name] = files[name][:at] + value + files[name][at:]


def remove_part(files, name, a, b, value):
    at = _place(files[name], a)
    files[name] = files[name][:at] + files[name][at + b % 40 :]


def repeat_part(files, name, a, b, value):
    at = _place(files[name], a)
    files[name] = files[name][:at] + files[name][at : at + b % 200] + files[name][at:]


def replace_all(files, name, a, b, value):
    files[name] = value


def swap(files, name, a, b, value):
    other = sorted(files)[a % len(files)]
    files[name], files[other] = files[other], files[name]


def absurd_word(files, name, a, b, value):
    words = files[name].split(b" ")
    words[a % len(words)] = ABSURD[b % len(ABSURD)].encode()
    files[name] = b" ".join(words)


def absurd_number(files, name, a, b, value):
    """Between a number's digits and whatever follows, so also where no blank is: in YAML and JSON."""
    data, digits = files[name], b"-.0123456789"
    starts = [i for i in range(len(data)) if data[i] in digits and (i == 0 or data[i - 1] not in digits)]
    if starts and not data.startswith(PNG_SIGNATURE):
        start = end = starts[a % len(starts)]
        while end < len(data) and data[end] in digits:
            end += 1
        files[name] = data[:start] + ABSURD[b % len(ABSURD)].encode() + data[end:]


def change_chunk(files, name, a, b, value):
    """A PNG chunk with other content and the right checksum."""
    data = files[name]
    if not data.startswith(PNG_SIGNATURE):
        return
    chunks, at = [], len(PNG_SIGNATURE)
    while at + 12 <= len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        chunks.append(data[at + 4 : end - 4])
        at = end
    if not chunks:
        return
    changed = bytearray(chunks[a % len(chunks)])
    at = b % len(changed)
    changed[at : at + len(value)] = value
    chunks[a % len(chunks)] = bytes(changed)
    files[name] = PNG_SIGNATURE + b"".join(
        (len(chunk) - 4).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
        for chunk in chunks
        if len(chunk) >= 4
    )


def rename(files, name, a, b, value):
    data = files.pop(name)
    new = os.fsdecode(value.replace(b"/", b"").replace(b"\0", b"")[:20]) or "renamed"
    kept = name.rsplit("/", 1)
    suffix = "." + kept[-1].split(".", 1)[-1] if b % 2 else ""
    if new not in (".", ".."):
        files["/".join([*kept[:-1], new + suffix])] = data


DAMAGES = (
    cut, flip, insert, remove_part, repeat_part, replace_all, swap, absurd_word, absurd_number, change_chunk, rename,
)  # fmt: skip
numbers = st.integers(0, 1 << 20)
damages = st.lists(
    st.tuples(st.sampled_from(DAMAGES), numbers, numbers, numbers, st.binary(max_size=24)), min_size=1, max_size=4
)


@pytest.mark.parametrize("format", WRITERS)
@fuzzing(120)
@given(damages, st.booleans(), st.booleans())
def test_a_damaged_recording(format, damages, told, with_rig):
    files = dict(files_of(format))
    for damage, which, a, b, value in damages:
        if files:
            damage(files, sorted(files)[which % len(files)], a, b, value)
    with tempfile.TemporaryDirectory() as parent, bounded():
        folder = Path(parent) / "recording"
        folder.mkdir()
        with contextlib.suppress(FileExistsError, IsADirectoryError, NotADirectoryError):  # renamed onto a folder
            write_files(folder, files)
        read_everything(folder, format if told else None, rig_of(format) if with_rig or format in NEEDS_RIG else None)


def test_the_recordings_are_sound_before_they_are_damaged(tmp_path):
    for format in WRITERS:
        write_files(tmp_path / format, files_of(format))
        assert read_everything(tmp_path / format, None, rig_of(format) if format in NEEDS_RIG else None) == []


def structural_places(name: str, data: bytes) -> list[int]:
    """Where a file can be cut so that what is left means something else: around every mark, not within words."""
    if data.startswith(PNG_SIGNATURE):
        places, at = {0, 4, len(PNG_SIGNATURE)}, len(PNG_SIGNATURE)
        while at + 12 <= len(data):
            end = at + 12 + int.from_bytes(data[at : at + 4], "big")
            places |= {at, at + 4, at + 8, end - 4, end}
            at = end
        return sorted(p for p in places if p < len(data))
    if name.endswith(".mat"):
        return list(range(0, 129, 4)) + list(range(129, min(len(data), 400), 3)) + [len(data) - 1]
    marks = b" \t\r\n:,.-[]{}\"'#|>&*!%@\\/"
    return sorted({p for i, byte in enumerate(data) if byte in marks for p in (i, i + 1) if p < len(data)})


@pytest.mark.parametrize("format", WRITERS)
def test_a_file_cut_at_every_structural_byte(format, tmp_path):
    files, rig = files_of(format), rig_of(format) if format in NEEDS_RIG else None
    write_files(tmp_path, files)
    with bounded():
        for name, data in files.items():
            for place in structural_places(name, data):
                (tmp_path / name).write_bytes(data[:place])
                problems = read_everything(tmp_path, format, rig)
                if name.endswith((".png", ".mat")):  # half an image is never taken for one
                    assert problems and any(Path(name).name in str(problem) for problem in problems), (name, place)
            (tmp_path / name).write_bytes(data)
    assert read_everything(tmp_path, format, rig) == []


@pytest.mark.parametrize("format", WRITERS)
@pytest.mark.parametrize("kind", ["fifo", "loop", "endless", "outside", "folder", "gone"])
def test_a_file_that_is_none(format, kind, tmp_path):
    outside = tmp_path / "outside"
    rig = rig_of(format) if format in NEEDS_RIG else None
    for name, data in files_of(format).items():
        folder = tmp_path / name.replace("/", "_") / "recording"
        write_files(folder, files_of(format))
        path = folder / name
        path.unlink()
        if kind == "fifo":
            os.mkfifo(path)
        elif kind == "loop":
            path.symlink_to(path)
        elif kind == "endless":
            path.symlink_to("/dev/zero")
        elif kind == "outside":
            outside.write_bytes(data)
            path.symlink_to(outside)
        elif kind == "folder":
            path.mkdir()
        with bounded():
            problems = read_everything(folder, format, rig)
        optional = kind == "gone" and "confidence" in name  # phones do not always record it
        if name.endswith((".png", ".mat")) and "/" in name and not optional:
            assert problems, name


@pytest.mark.parametrize("link", ["recording.yaml", "rig.yaml"])
def test_a_text_file_without_end(link, tmp_path):
    write_files(tmp_path, files_of("adagmm"))
    with open(tmp_path / link, "r+b") as file:
        file.truncate(1 << 40)  # a hole: it takes no room
    with bounded():
        (problem,) = read_everything(tmp_path)
    assert link in str(problem)


# Bytes on their own


def at_path(data: bytes, suffix: str, read, errors=AdaGMMError, memory: int | None = MEMORY_BYTES):
    with tempfile.TemporaryDirectory() as folder, bounded(memory):
        path = Path(folder) / f"file{suffix}"
        path.write_bytes(data)
        try:
            return read(path)
        except errors as problem:
            assert str(path) in str(problem) and "\n" not in str(problem)
            return None


yaml_text = st.lists(
    st.sampled_from(ABSURD) | st.sampled_from([" ", ": ", ", ", "\n", "\n  ", "a", "- ", "'", '"', "|", ">", "?"]),
    max_size=40,
)
yaml_bytes = st.binary(max_size=200) | yaml_text.map(lambda parts: "".join(parts).encode())


@fuzzing(400)
@given(yaml_bytes)
def test_bytes_as_yaml(data):
    at_path(data, ".yaml", lambda path: read_yaml(path, RigError), RigError)


@fuzzing(200)
@given(yaml_bytes, numbers, st.booleans())
def test_bytes_within_a_rig(data, place, whole):
    rig = files_of("adagmm")["rig.yaml"]
    at = place % len(rig)
    at_path(data if whole else rig[:at] + data + rig[at:], ".yaml", load_rig, RigError)


MATRIX = "!!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1. ]"
OPENCV_FILES = {
    ".yml": """%YAML:1.0
---
image_width: 16
image_height: 12
K: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 14., 0., 7.5, 0., 14., 5.5, 0., 0., 1. ]
""",
    ".json": """{"image_width": 16, "image_height": 12,
 "K": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
       "data": [14.0, 0.0, 7.5, 0.0, 14.0, 5.5, 0.0, 0.0, 1.0]}}
""",
    ".xml": """<?xml version="1.0"?>
<opencv_storage>
<image_width>16</image_width><image_height>12</image_height>
<K type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>14. 0. 7.5 0. 14. 5.5 0. 0. 1.</data></K>
</opencv_storage>
""",
}


@pytest.mark.parametrize("suffix", OPENCV_FILES)
def test_opencv_files_are_sound_before_they_are_damaged(suffix):
    assert at_path(OPENCV_FILES[suffix].encode(), suffix, read_camera).intrinsics.fx == 14.0


@pytest.mark.parametrize("suffix", OPENCV_FILES)
@fuzzing(8)  # each starts a process
@given(damages)
def test_damaged_opencv_files(suffix, damages):
    files = {"file": OPENCV_FILES[suffix].encode()}
    for damage, _, a, b, value in damages:
        if damage not in (rename, swap):
            damage(files, "file", a, b, value)
    at_path(files["file"], suffix, read_camera, RigError)


@pytest.mark.parametrize(
    "matrix",
    [
        "3",
        "[1, 2]",
        "{a: 1}",
        "!!opencv-matrix\n   rows: 3\n   cols: 3",
        MATRIX.replace("3", "900"),
        MATRIX.replace("d", "q"),
    ],
)
def test_opencv_files_whose_matrix_is_none(matrix):
    for read in (read_camera, lambda path: read_stereo_pose(path, 1.0)):
        for name in ("K", "R"):
            at_path(f"%YAML:1.0\n---\n{name}: {matrix}\n".encode(), ".yml", read, RigError)


@fuzzing(200)
@given(
    st.sampled_from([b"", PNG_SIGNATURE, b"\xff\xd8\xff\xe0", b"\xff\xd8\xff\xc0\x00\x11\x08"]), st.binary(max_size=120)
)
def test_bytes_as_images(magic, data):
    for read in (read_color, read_depth, image_size):
        at_path(magic + data, ".png", read, RecordingError)


@fuzzing(200)
@given(st.binary(max_size=200))
def test_bytes_as_matlab_files(data):
    at_path(b" " * 124 + b"\x00\x01IM" + data, ".mat", lambda path: read_variable(path, "depth_array"), RecordingError)


def test_a_matlab_file_of_very_many_elements():
    many = (b"\x09\x00\x00\x00\x00\x00\x00\x00") * 500_000
    at_path(b" " * 124 + b"\x00\x01IM" + many, ".mat", lambda path: read_variable(path, "x"), RecordingError)


@pytest.mark.parametrize("suffix", [".bag", ".mkv"])
@fuzzing(10)
@given(st.sampled_from([b"", b"#ROSBAG V2.0\n", b"\x1aE\xdf\xa3"]), st.binary(max_size=100))
def test_bytes_as_video(suffix, magic, data):
    # Open3D's readers start threads, whose address space is no memory, and end the process where they get none.
    at_path(magic + data, suffix, lambda path: read_everything(path) and None, InputError, memory=None)


@pytest.mark.parametrize("kinds", [k for n in range(4) for k in itertools.permutations(("IHDR", "IDAT", "IEND"), n)])
@pytest.mark.parametrize("emptied", [(), ("IHDR",), ("IDAT",), ("IHDR", "IDAT")])
def test_an_image_of_some_chunks_in_any_order(kinds, emptied):
    """Whole chunks with the right checksums, of which the one with the size is not always there or the first."""
    contents = {"IHDR": png_header(4, 4, 16, 0), "IDAT": zlib.compress(b"\0" * 36), "IEND": b""}
    contents |= dict.fromkeys(emptied, b"")
    data = PNG_SIGNATURE + b"".join(png_chunk(kind.encode(), contents[kind]) for kind in kinds)
    image = at_path(data, ".png", read_depth, RecordingError)
    assert (image is not None) == (kinds == ("IHDR", "IDAT", "IEND") and not emptied)
    at_path(data, ".png", read_color, RecordingError)
    at_path(data, ".png", image_size, RecordingError)


# Pictures that say they are larger than they can be


def png_header(width: int, height: int, bits: int, color_type: int) -> bytes:
    return width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes([bits, color_type, 0, 0, 0])


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return len(data).to_bytes(4, "big") + kind + data + zlib.crc32(kind + data).to_bytes(4, "big")


def png(width: int, height: int, bits: int, color_type: int, pixels: bytes) -> bytes:
    header = png_header(width, height, bits, color_type)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(pixels)), (b"IEND", b""))
    return PNG_SIGNATURE + b"".join(png_chunk(*chunk) for chunk in chunks)


def jpeg(width: int, height: int, start_of_frame: int) -> bytes:
    frame = (
        b"\x00\x11\x08"
        + height.to_bytes(2, "big")
        + width.to_bytes(2, "big")
        + b"\x03\x01\x22\x00\x02\x11\x01\x03\x11\x01"
    )
    return (
        b"\xff\xd8\xff"
        + bytes([start_of_frame])
        + frame
        + b"\xff\xda\x00\x0c\x03\x01\x00\x02\x11\x03\x11\x00\x3f\x00\xff\xd9"
    )


@pytest.mark.parametrize("read", [read_color, read_depth])
@pytest.mark.parametrize(
    "data",
    [
        png(30_000, 30_000, 16, 0, b"\0" * 1000),
        png(1 << 20, 1 << 20, 16, 0, b""),
        png(0xFFFFFFFF, 0xFFFFFFFF, 8, 2, b""),
        png(0, 5, 8, 2, b""),
        jpeg(65_535, 65_535, 0xC0),
        jpeg(30_000, 30_000, 0xC2),
    ],
    ids=["png of 900 megapixels", "png of a terapixel", "png of 2^64", "png of none", "jpeg", "progressive jpeg"],
)
def test_an_image_that_says_it_is_huge(read, data):
    assert at_path(data, ".png", read, RecordingError) is None


def test_formats_left_out_here_are_not_folders_of_files():
    assert set(FORMATS) - set(WRITERS) == {"video", "rosbag"}
