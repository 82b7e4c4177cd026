"""Small files that would make much work, and marks that editors leave: work grows with the file, totals are bounded."""

import codecs
import os
import tracemalloc
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.io
import yaml
from reader_cases import INTRINSICS, NEEDS_RIG, WRITERS, files_of, read_everything, rig_of, write_files

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files import strict_yaml
from adagmm_fusion.files.input_file import read_input
from adagmm_fusion.files.strict_yaml import read_yaml
from adagmm_fusion.formats import bag_stream, matlab_file, own
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig


@pytest.fixture
def inflated(monkeypatch):
    """How many bytes the reader of .mat files has inflated, a number for each call."""
    counts = []

    class Counting:
        def __init__(self):
            self._stream = zlib.decompressobj()

        def decompress(self, *arguments):
            data = self._stream.decompress(*arguments)
            counts.append(len(data))
            return data

        @property
        def eof(self):
            return self._stream.eof

    monkeypatch.setattr(matlab_file, "zlib", SimpleNamespace(decompressobj=Counting, error=zlib.error))
    return counts


def test_only_the_variable_that_is_wanted_is_inflated(tmp_path, inflated):
    path = tmp_path / "a.mat"
    others = {f"other_{i}": np.zeros((200, 200)) for i in range(40)}
    scipy.io.savemat(path, others | {"depth": np.ones((3, 4))}, do_compression=True)
    assert np.array_equal(matlab_file.read_variable(path, "depth"), np.ones((3, 4)))
    assert sum(inflated) < 42 * matlab_file.HEAD_BYTES
    with pytest.raises(RecordingError, match="there is no variable 'none' in it"):
        matlab_file.read_variable(path, "none")


def test_the_number_of_variables_is_bounded(tmp_path, monkeypatch):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {f"v{i}": np.ones(1) for i in range(5)}, do_compression=True)
    monkeypatch.setattr(matlab_file, "MAX_VARIABLES", 5)
    assert matlab_file.read_variable(path, "v4") == 1.0
    with pytest.raises(RecordingError, match="there is no variable"):
        matlab_file.read_variable(path, "w")
    monkeypatch.setattr(matlab_file, "MAX_VARIABLES", 4)
    with pytest.raises(RecordingError, match=r"a\.mat: the MATLAB file is damaged .*: it has more than 4 variables"):
        matlab_file.read_variable(path, "v4")


def test_a_bomb_in_the_variable_that_is_wanted(tmp_path):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"depth": np.zeros((3000, 3000))}, do_compression=True)
    assert path.stat().st_size < 100_000
    with pytest.raises(RecordingError, match="a compressed variable is incomplete or too large"):
        matlab_file.read_variable(path, "depth")


# YAML

DOCUMENTS = [
    "a: 1\nb: [x, 'y', \"z\"]\nc: {d: -1.5e-3, e: |\n  text\n  }\n",
    "a: 1\nb:\n  - c: >\n      folded\n      text\n    d: 'it''s'\n  - []\n  - {}\n",
    "# comment\n\nname: zwei räume → 部屋\n",
    "a: 1\na: 2\n",
    "a: &x 1\n",
    "a: *x\n",
    "a: !!str 1\n",
    "a: [1\n",
    "a: 'b\n",
    "\ta: 1\n",
    "a: b: c\n",
    '"\\uD800": 1\n',
    'a: "\\x1b"\n',
    "a: 1\n---\nb: 2\n",
    "--- \na: 1\n...\n",
    "",
    "[" * 40 + "]" * 40,
    "a: \x07\n",
    "? a\n: b\n",
]


@pytest.mark.parametrize("text", DOCUMENTS, ids=lambda text: repr(text[:24]))
def test_both_parsers_read_the_same(text, tmp_path, monkeypatch):
    """libyaml's and, where PyYAML was built without it, the slow one; a refusal may be worded otherwise."""
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    found = []
    for loader in (yaml.SafeLoader, getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
        monkeypatch.setattr(strict_yaml, "LOADER", loader)
        try:
            found.append(read_yaml(tmp_path / "a.yaml", RecordingError))
        except RecordingError as problem:
            assert "\n" not in str(problem)
            found.append("refused")
    assert found[0] == found[1]


def test_the_values_of_a_document_are_bounded(tmp_path, monkeypatch):
    path = tmp_path / "a.yaml"
    path.write_text("a: [1, 2]\n")  # the document, a key, a list, two numbers
    monkeypatch.setattr(strict_yaml, "MAX_VALUES", 5)
    assert read_yaml(path, RecordingError).mapping()["a"].numbers() == (1.0, 2.0)
    path.write_text("a: [1, 2,\n 3]\n")
    with pytest.raises(RecordingError, match=r"a\.yaml:2: a\[2\]: expected a document of at most 5 values"):
        read_yaml(path, RecordingError)


def test_frames_and_sensors_are_bounded_together(tmp_path):
    """Neither of them is many, but all of one with all of the other are."""
    write_files(tmp_path, files_of("adagmm"))
    sensors = [f"s{i}" for i in range(2000)]
    frames = "".join(f'  - name: "{i}"\n' for i in range(own.MAX_IMAGES // len(sensors) + 1))
    head = "format: adagmm-recording\nversion: 1\nname: x\nrig: rig.yaml\nmotion: fixed\n"
    (tmp_path / "recording.yaml").write_text(f"{head}sensors: [{', '.join(sensors)}]\nframes:\n{frames}")
    calibrations = {name: SensorCalibration(name, INTRINSICS, 1000.0, None) for name in sensors}
    save_rig(tmp_path / "rig.yaml", Rig("many", calibrations))
    with pytest.raises(RecordingError, match="expected at most 1000000 frames of all sensors"):
        open_recording(tmp_path)


# Lists


def test_stamps_that_are_all_the_same(tmp_path):
    """Every colour image would be compared with every depth image."""
    folder = tmp_path / "freiburg1"
    write_files(folder, files_of("tum"))
    for kind in ("rgb", "depth"):
        (folder / f"{kind}.txt").write_text("".join(f"100.0 {kind}/{i}.png\n" for i in range(101)))
    with pytest.raises(RecordingError, match=r"rgb\.txt: expected timestamps in seconds, there are 101 colour images"):
        open_recording(folder)


def test_one_message_of_a_bag_is_read_alone():
    """Not by walking through all that come before it."""
    entries = [object() for _ in range(5)]
    seen = []

    class Reader:
        indexes = {0: list(entries)}  # noqa: RUF012

        def messages(self, connections):
            seen.append(list(self.indexes[0]))
            yield None, 0, b""

    stream = object.__new__(bag_stream.BagStream)
    stream.path, stream._reader = "a.bag", Reader()
    stream._topics = {"topic": SimpleNamespace(id=0, msgtype="")}
    stream._types = SimpleNamespace(deserialize_ros1=lambda data, kind: data)
    for entry in (entries[3], entries[0]):
        assert stream._message("topic", entry) == b""
    assert seen == [[entries[3]], [entries[0]]]


# Marks before a text


@pytest.mark.parametrize("format", [format for format in WRITERS if format != "sens"])  # there is no text in it
def test_a_byte_order_mark_changes_nothing(format, tmp_path):
    """What Notepad puts before every text that it saves."""
    files = files_of(format)
    marked = {
        name: codecs.BOM_UTF8 + data if name.endswith((".txt", ".csv", ".log", ".yaml", ".json", "metadata")) else data
        for name, data in files.items()
    }
    if format == "redwood":
        size = '{"width": 16, "height": 12, "intrinsic_matrix": [14, 0, 0, 0, 14, 0, 7.5, 5.5, 1]}'
        marked["camera_intrinsic.json"] = codecs.BOM_UTF8 + size.encode()
    assert any(data.startswith(codecs.BOM_UTF8) for data in marked.values())
    write_files(tmp_path / "with", marked)
    write_files(tmp_path / "without", {name: data.removeprefix(codecs.BOM_UTF8) for name, data in marked.items()})
    rig = rig_of(format) if format in NEEDS_RIG else None
    recordings = [open_recording(tmp_path / name, format=format, rig=rig) for name in ("with", "without")]
    assert read_everything(tmp_path / "with", format, rig) == []
    first, second = ([(e.name, e.timestamp) for e in recording.entries] for recording in recordings)
    assert first == second
    for a, b in zip(recordings[0].entries, recordings[1].entries, strict=True):
        assert (a.T_world_camera is None) == (b.T_world_camera is None)
        assert a.T_world_camera is None or np.array_equal(a.T_world_camera, b.T_world_camera)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="a file of Linux that says it is empty")
def test_memory_is_asked_for_what_a_file_has(tmp_path):
    """Not for what it might have: that much is refused where memory is limited."""
    path = tmp_path / "a.txt"
    path.write_bytes(b"x" * 100_000)
    tracemalloc.start()
    try:
        assert len(read_input(path, RecordingError)) == 100_000
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()
    assert b"Pid:" in read_input(Path("/proc/self/status"), RecordingError)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of POSIX")
@pytest.mark.parametrize(("name", "format"), [("a.sens", "sens"), ("a.r3d", "record3d"), ("a.mcap", "rosbag")])
def test_a_pipe_that_is_called_a_recording(tmp_path, name, format):
    """Opened it would be waited for for ever."""
    os.mkfifo(tmp_path / name)
    with pytest.raises(RecordingError, match=f"{name}: cannot be read: it is a pipe or a device, not a file"):
        open_recording(tmp_path / name, format=format)


# Files that may be there or not, beside those of `files_of`; and what is not read, whatever it is.
OPTIONAL = {
    "tum": ("associations.txt", "pairs.txt"),
    "posefile": ("pairs.txt",),
    "redwood": ("camera_intrinsic.json",),
    "folder": ("intrinsics.yaml", "poses.txt"),
    "replica": ("cam_params.json",),
}
NOT_READ = {("scanner-app", "info.json"), ("scanner-app", "frame_00002.json")}


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of POSIX")
@pytest.mark.parametrize("format", WRITERS)
def test_a_pipe_in_the_place_of_any_file_is_said(format, tmp_path):
    """Neither waited for nor taken for absent, the files that may be absent included."""
    files = files_of(format)
    rig = rig_of(format) if format in NEEDS_RIG else None
    names = [name for name in (*files, *OPTIONAL.get(format, ())) if (format, name) not in NOT_READ]
    for index, name in enumerate(names):
        folder = tmp_path / str(index)
        write_files(folder, {other: data for other, data in files.items() if other != name})
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        os.mkfifo(folder / name)
        said = [str(problem) for problem in read_everything(folder, None, rig)]
        assert any(line.startswith(f"{folder / name}: cannot be read: it is a pipe") for line in said), (name, said)


@pytest.mark.parametrize("name", ["groundtruth.txt", "associations.txt", "pairs.txt"])
def test_a_list_that_is_a_link_to_nothing_is_said(name, tmp_path):
    write_files(tmp_path, files_of("tum"))
    (tmp_path / name).unlink(missing_ok=True)
    (tmp_path / name).symlink_to("nowhere")
    with pytest.raises(RecordingError, match=f"{name}: cannot be read: it is a link to nothing"):
        open_recording(tmp_path, rig=rig_of("tum"))


def test_a_list_that_is_a_folder_is_said(tmp_path):
    write_files(tmp_path, files_of("tum"))
    (tmp_path / "pairs.txt").mkdir()
    with pytest.raises(RecordingError, match=r"pairs\.txt: cannot be read"):
        open_recording(tmp_path, rig=rig_of("tum"))
