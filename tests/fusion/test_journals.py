"""Kept registrations and trials: of other calibrations, images, settings or programs, changed by hand, and no files at
all. What is kept is used where it is what would be found anew, and refused in one line where it is anything else."""

import dataclasses
import json
import os
import shutil
import sys

import numpy as np
import pytest
from depth_scene import camera_pose, write_pose_file

import adagmm_fusion.commands.fuse as fuse_module
import adagmm_fusion.sequence.edges as edges_module
from adagmm_bench.journal import Journal
from adagmm_fusion.cli import main
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.journal_lines import sealed, unsealed
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.digests import entry_digest, frame_digest
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig
from adagmm_fusion.sequence.edge_file import EdgeFile
from adagmm_fusion.sequence.edges import Edge
from adagmm_fusion.source_digest import source_digest
from adagmm_o3d import lie
from adagmm_o3d.errors import InputError

INTRINSICS = PinholeIntrinsics(80, 60, 70.0, 70.0, 39.5, 29.5)
POSES = [camera_pose(5.0 * i - 5.0, (0.03 * i, 0.05 * i, 1.2)) for i in range(3)]
T = lie.se_exp((0.1, 0.2, 0.3, 1.0, 2.0, 3.0))
EDGE = {
    "source": 1,
    "target": 0,
    "loop_closure": False,
    "reason": "",
    "transformation": T.tolist(),
    "information": np.diag(np.arange(1.0, 7.0)).tolist(),
}


# What a kept registration depends on


@pytest.fixture
def fused(tmp_path, monkeypatch, capsys):
    """A walk that has been fused; called again it says how it ended and how many pairs were registered."""
    folder = tmp_path / "walk"
    write_pose_file(folder, POSES, INTRINSICS)
    rig = Rig("one", {"camera": SensorCalibration("camera", INTRINSICS, 1000.0, None)})
    save_rig(tmp_path / "rig.yaml", rig)
    registered = []
    registered_edge = edges_module.registered_edge
    monkeypatch.setattr(
        "adagmm_fusion.sequence.registration.registered_edge",
        lambda *a, **k: registered.append(a[1:3]) or registered_edge(*a, **k),
    )

    def again(*more: str):
        registered.clear()
        arguments = ["fuse", str(folder), "--calibration", str(tmp_path / "rig.yaml"), "--voxel-size", "0.05"]
        code = main([*arguments, "--device", "cpu", "--mesh", "ply", "--output", str(tmp_path / "out"), *more])
        return code, len(registered), capsys.readouterr().err

    assert again()[:2] == (0, 2)
    return again, folder, rig


def change_the_calibration(folder, rig, monkeypatch):
    sensor = rig.sensors["camera"]
    wrong = dataclasses.replace(sensor, intrinsics=dataclasses.replace(INTRINSICS, fx=60.0))
    save_rig(folder.parent / "rig.yaml", dataclasses.replace(rig, sensors={"camera": wrong}))


def change_the_depth_scale(folder, rig, monkeypatch):
    wrong = dataclasses.replace(rig.sensors["camera"], depth_scale=1001.0)
    save_rig(folder.parent / "rig.yaml", dataclasses.replace(rig, sensors={"camera": wrong}))


def change_an_image(folder, rig, monkeypatch):
    first, second = sorted((folder / "depth").iterdir())[:2]
    shutil.copy(second, first)


def change_the_program(folder, rig, monkeypatch):
    monkeypatch.setattr("adagmm_fusion.source_digest.source_digest", lambda *a, **k: "another")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (change_the_calibration, "another content of the images or calibration"),
        (change_the_depth_scale, "another content of the images or calibration"),
        (change_an_image, "another content of the images or calibration"),
        (change_the_program, "another program"),
    ],
)
def test_registrations_of_something_else_are_not_used(fused, monkeypatch, change, named):
    again, folder, rig = fused
    kept = (folder.parent / "out" / "registrations.jsonl").read_bytes()
    assert again()[:2] == (0, 0), "all of them were there"
    change(folder, rig, monkeypatch)
    code, registered, err = again()
    assert (code, registered) == (1, 0) and err.count("\n") == 1
    assert "registrations.jsonl: holds registrations of another recording, or made otherwise" in err and named in err
    assert (folder.parent / "out" / "registrations.jsonl").read_bytes() == kept


def test_registrations_with_other_settings_are_not_used(fused):
    code, _, err = fused[0]("--max-depth", "4.5")
    assert code == 1 and "(another settings)" in err


def test_the_same_images_in_other_files_are_the_same(fused):
    """What counts is what is registered, not the bytes of a file or its time."""
    again, folder, _ = fused
    for path in folder.rglob("*.png"):
        os.utime(path, (0, 0))
    assert again()[:2] == (0, 0)


def test_a_digest_changes_with_every_part_of_a_frame(tmp_path):
    write_pose_file(tmp_path / "walk", POSES, INTRINSICS)
    entry = open_recording(tmp_path / "walk").entries[0]
    frame = entry.load()
    assert frame_digest(frame) == frame_digest(entry.load()) == entry_digest(entry)
    color, depth = frame.color.copy(), frame.depth.copy()
    color[-1, -1, 2] ^= 1
    depth[-1, -1] ^= 1
    changed = [
        dataclasses.replace(frame, color=color),
        dataclasses.replace(frame, depth=depth),
        dataclasses.replace(frame, depth_scale=1000.0000001),
        *(
            dataclasses.replace(frame, intrinsics=dataclasses.replace(frame.intrinsics, **more))
            for more in ({"fx": 70.0000001}, {"cy": 0.0}, {"distortion": (1e-9, 0.0, 0.0, 0.0)})
        ),
    ]
    assert len({frame_digest(frame), *map(frame_digest, changed)}) == 1 + len(changed)


def test_a_program_is_its_source_and_its_libraries(tmp_path, monkeypatch):
    package = tmp_path / "some_program"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "part.py").write_text("x = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = {source_digest.__wrapped__("some_program")}
    found.add(source_digest.__wrapped__("some_program.part"))
    found.add(source_digest.__wrapped__("some_program", distributions=("numpy",)))
    (package / "part.py").write_text("x = 2\n")
    found.add(source_digest.__wrapped__("some_program"))
    assert len(found) == 4
    assert len(fuse_module.REGISTERED_BY) > 1 and source_digest(*fuse_module.REGISTERED_BY)


# Changed by hand


def written(path, *records, seal=sealed) -> None:
    """A file of edges with these records, each with a right check unless `seal` makes another line."""
    EdgeFile(path, {}, 3)
    with open(path, "a") as file:
        file.writelines(seal(record) + "\n" for record in records)


BAD_EDGES = [
    *({"source": value} for value in (999, 3, -1, "a", None, 1.5, [1], True, 10**30)),
    *({"transformation": value} for value in ([[1.0] * 3] * 3, [[0.0] * 4] * 4, [[1e300] * 4] * 4, None, "a", 1, {})),
    {"transformation": [["a"] * 4] * 4},
    {"transformation": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()},
    *({"information": value} for value in ((-np.eye(6)).tolist(), [[1, 0], [0, 1]], None, "a", [[1e999]])),
    {"information": np.triu(np.ones((6, 6))).tolist()},
    {"reason": 5},
    {"reason": None},
    {"reason": "with no pose, but", "transformation": None},
    {"loop_closure": "x"},
    {"loop_closure": 1},
]


@pytest.mark.parametrize("change", BAD_EDGES, ids=str)
def test_an_edge_that_is_none(tmp_path, change):
    """Even where its check is right: it may be another program's."""
    path = tmp_path / "edges.jsonl"
    written(path, EDGE | change, seal=lambda record: _sealed_anyhow(record))
    with pytest.raises(OutputError, match=r"edges\.jsonl:2: is damaged \(.*\); delete it to start anew$") as caught:
        EdgeFile(path, {}, 3)
    assert "\n" not in str(caught.value)


def _sealed_anyhow(record):
    """As sealed, also of what is not finite."""
    try:
        return sealed(record)
    except ValueError:
        return json.dumps(record)


@pytest.mark.parametrize("key", EDGE)
def test_an_edge_without_a_part(tmp_path, key):
    written(tmp_path / "edges.jsonl", {k: v for k, v in EDGE.items() if k != key})
    with pytest.raises(OutputError, match=r"edges\.jsonl:2: is damaged"):
        EdgeFile(tmp_path / "edges.jsonl", {}, 3)


def test_a_number_that_was_changed(tmp_path):
    path = tmp_path / "edges.jsonl"
    written(path, EDGE)
    EdgeFile(path, {}, 3)
    path.write_text(path.read_text().replace("1.0", "7.0", 1))
    with pytest.raises(OutputError, match=r"edges\.jsonl:2: is damaged \(it is not what was written\)"):
        EdgeFile(path, {}, 3)


LINES = ["[" * 100_000, "5", "", "null", '"a"', "[]", "{}", '{"a": NaN}', '{"a": 1e999}', "\x00" * 4096, "9" * 5000]


@pytest.mark.parametrize("line", LINES, ids=lambda line: repr(line[:12]))
@pytest.mark.parametrize("where", ["first", "later"])
def test_lines_that_are_no_records(tmp_path, line, where):
    path = tmp_path / "edges.jsonl"
    written(path, EDGE)
    text = path.read_text()
    path.write_text(f"{line}\n" + text if where == "first" else f"{text}{line}\n")
    with pytest.raises(OutputError, match=rf"edges\.jsonl:{1 if where == 'first' else 3}: is damaged") as caught:
        EdgeFile(path, {}, 3)
    assert len(str(caught.value)) < 500 and "\n" not in str(caught.value)
    bench = tmp_path / "results.jsonl"
    with Journal(bench) as journal:
        journal.append({"key": "a"})
    text = bench.read_text()
    bench.write_text(f"{line}\n" + text if where == "first" else f"{text}{line}\n")
    with pytest.raises(InputError, match=rf"results\.jsonl:{1 if where == 'first' else 2}: expected a JSON record"):
        Journal(bench)


def test_edges_twice(tmp_path):
    path = tmp_path / "edges.jsonl"
    written(path, EDGE, EDGE)
    assert len(EdgeFile(path, {}, 3).edges) == 1  # it would count twice
    written(path, EDGE | {"transformation": np.eye(4).tolist()})
    with pytest.raises(OutputError, match="these frames have an edge already"):
        EdgeFile(path, {}, 3)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3, 0.6, 0.9, 0.999])
def test_a_file_that_was_cut_off(tmp_path, share):
    path = tmp_path / "edges.jsonl"
    written(path, EDGE, EDGE | {"source": 2, "target": 1})
    data = path.read_bytes()
    for tail in (b"", b"\0" * 4096):
        path.write_bytes(data[: int(share * len(data))] + tail)
        edges = EdgeFile(path, {}, 3).edges
        assert len(edges) < 2 and all(np.array_equal(edge.transformation, T) for edge in edges)


def test_a_record_of_a_trial_that_was_changed(tmp_path):
    path = tmp_path / "results.jsonl"
    with Journal(path) as journal:
        journal.append({"key": "a", "overlap": 0.25})
    with Journal(path) as journal:
        assert journal.records == {"a": {"key": "a", "overlap": 0.25}}
    path.write_text(path.read_text().replace("0.25", "0.75"))
    with pytest.raises(InputError, match=r"results\.jsonl:1: .* as it was written, got .*start anew with --fresh$"):
        Journal(path)


def test_a_line_is_read_as_it_was_written():
    record = {"b": [1.0, 1e-300, 0.1 + 0.2], "a": {"ü": None}, "n": 3}
    assert unsealed(sealed(record)) == record and "\n" not in sealed(record)
    with pytest.raises(ValueError, match="JSON compliant"):
        sealed({"a": float("nan")})


# No files


@pytest.mark.skipif(sys.platform == "win32", reason="links and pipes of POSIX")
@pytest.mark.parametrize("kind", ["folder", "pipe", "link"])
def test_a_journal_that_is_no_file(tmp_path, kind):
    path = tmp_path / "journal.jsonl"
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(tmp_path / "elsewhere")
    for opened in (lambda: EdgeFile(path, {}, 3), lambda: Journal(path)):
        with pytest.raises(OutputError, match=r"journal\.jsonl: expected a file to replace, or none, it is a "):
            opened()
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.skipif(sys.platform == "win32", reason="links of POSIX")
def test_a_journal_that_becomes_a_link_is_not_followed(tmp_path):
    file = EdgeFile(tmp_path / "edges.jsonl", {}, 3)
    (tmp_path / "precious").write_text("precious")
    file.path.unlink()
    file.path.symlink_to(tmp_path / "precious")
    with pytest.raises(OutputError, match="cannot be written"):
        file.add(Edge(1, 0, T, np.eye(6), False))
    assert (tmp_path / "precious").read_text() == "precious"
