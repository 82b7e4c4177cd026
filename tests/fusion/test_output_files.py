"""Where results go: checked before the work; nothing but a file is replaced, through no link and no planted name."""

import os
import stat
import sys
from pathlib import Path

import pytest
from reader_cases import files_of, write_files
from shared_data import ROOT

import adagmm_fusion.commands.run
from adagmm_fusion.cli import main
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import check_output_file, replacing, write_text
from adagmm_fusion.files.output_folder import exclusive
from adagmm_fusion.meshes.textured_mesh import save_textured_mesh
from adagmm_fusion.rerun_log.picture import save_picture

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="links, pipes and devices of POSIX")
SHIPPED = str(ROOT / "recordings" / "two_kinects")


def planted(path: Path, kind: str) -> None:
    """Something at a path that is no file to be replaced."""
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "link":
        (path.parent / "precious.txt").write_text("precious")
        path.symlink_to(path.parent / "precious.txt")
    elif kind == "link to nothing":
        path.symlink_to(path.parent / "not there")
    elif kind == "link to a device":
        path.symlink_to(os.devnull)
    else:
        raise ValueError(kind)


KINDS = ("folder", "pipe", "link", "link to nothing", "link to a device")


@pytest.mark.parametrize("kind", KINDS)
def test_only_a_file_is_replaced(tmp_path, kind):
    path = tmp_path / "result.txt"
    planted(path, kind)
    before = path.lstat()
    for write in (check_output_file, lambda p: write_text(p, "new")):
        with pytest.raises(OutputError, match=r"result\.txt: expected a file to replace, or none, it is a ") as caught:
            write(path)
        assert "\n" not in str(caught.value)
    assert path.lstat() == before
    assert {p.name for p in tmp_path.iterdir()} <= {"result.txt", "precious.txt"}
    if kind == "link":
        assert (tmp_path / "precious.txt").read_text() == "precious"


def test_a_device_is_not_replaced():
    with pytest.raises(OutputError, match=f"^{os.devnull}: expected a file to replace, or none, it is a device"):
        write_text(os.devnull, "new")
    assert stat.S_ISCHR(os.lstat(os.devnull).st_mode)


@pytest.mark.parametrize("name", ["", ".", "..", "/", "a/..", "x" * 300, "a\0b"])
def test_names_of_no_file(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for write in (check_output_file, lambda p: write_text(p, "new")):
        with pytest.raises(OutputError):
            write(name)
    assert list(tmp_path.iterdir()) == []


def test_where_no_file_can_be_made(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="is no folder"):
        check_output_file(tmp_path / "file" / "new" / "result.txt")
    check_output_file(tmp_path / "not" / "there" / "yet.txt")
    check_output_file(tmp_path / "file")


def test_the_temporary_file_is_made_for_it_alone(tmp_path):
    """Its name cannot be told before, and it is there already as a file of its own when it is handed out."""
    names = set()
    for _ in range(3):
        with replacing(tmp_path / "a.bin") as temporary:
            status = temporary.lstat()
            assert stat.S_ISREG(status.st_mode) and status.st_size == 0 and temporary.suffix == ".bin"
            names.add(temporary.name)
            temporary.write_bytes(b"1")
    assert len(names) == 3 and [p.name for p in tmp_path.iterdir()] == ["a.bin"]


def test_a_planted_temporary_name_is_not_written_through(tmp_path, monkeypatch):
    monkeypatch.setattr("adagmm_fusion.files.atomic_file.secrets.token_hex", lambda _: "known")
    (tmp_path / "precious.txt").write_text("precious")
    (tmp_path / ".a-known.bin").symlink_to(tmp_path / "precious.txt")
    with pytest.raises(OutputError, match=r"a\.bin: cannot be written: File exists"), replacing(tmp_path / "a.bin"):
        raise AssertionError("it must not be handed out")
    assert (tmp_path / "precious.txt").read_text() == "precious"


@pytest.fixture
def no_work(monkeypatch):
    """Fails where the pairs are begun before the targets were looked at."""

    def never(*_):
        raise AssertionError("it began before it knew where the results go")

    monkeypatch.setattr(adagmm_fusion.commands.run, "run_pairs", never)
    monkeypatch.setattr(adagmm_fusion.commands.run, "compile_kernels", never)
    monkeypatch.setattr("adagmm_fusion.sequence.registration.register_scene", never)
    monkeypatch.setattr("adagmm_fusion.board_calibration.views.find_boards", never)


def is_refused(arguments: list[str], capsys) -> str:
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("adagmm-fusion: ")
    return err


@pytest.mark.parametrize("command", ["run", "fuse"])
@pytest.mark.parametrize("kind", ["", *KINDS])
def test_a_rerun_file_is_checked_before_the_work(tmp_path, command, kind, no_work, capsys):
    target = tmp_path / "x.rrd"
    if kind:
        planted(target, kind)
    arguments = [command, SHIPPED, "--output", str(tmp_path / "out"), "--save", str(target) if kind else ""]
    assert "expected " in is_refused(arguments, capsys)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("run", "report.json"),
        ("run", "report.md"),
        ("run", "rig.yaml"),
        ("run", "two_kinects.rrd"),
        ("fuse", "mesh.glb"),
        ("fuse", "trajectory_left.txt"),
    ],
)
def test_results_are_checked_before_the_work(tmp_path, command, name, no_work, capsys):
    (tmp_path / name).mkdir()
    assert f"{name}: expected a file to replace" in is_refused([command, SHIPPED, "--output", str(tmp_path)], capsys)


def test_a_rig_file_is_checked_before_the_work(tmp_path, no_work, capsys):
    (tmp_path / "rig.yaml").mkdir()
    arguments = ["calibrate", str(tmp_path), "--chessboard", "9x6", "--square", "0.03"]
    assert "rig.yaml: expected" in is_refused([*arguments, "--output", str(tmp_path / "rig.yaml")], capsys)


@pytest.mark.parametrize("command", ["run", "fuse"])
def test_a_recording_is_not_written_into(tmp_path, command, no_work, capsys):
    """Its own results would be read as its parts, a trajectory as its ground truth, and files of it be replaced."""
    room = tmp_path / "room"
    write_files(room, files_of("adagmm"))
    (tmp_path / "link").symlink_to(room)
    for folder in (room, tmp_path / "link", room / "left" / ".."):
        error = is_refused([command, str(room), "--output", str(folder)], capsys)
        assert "expected a folder for results, it is the recording" in error
    for file in ("recording.yaml", "left/depth/000000.png"):
        arguments = [command, str(room), "--output", str(tmp_path / "out"), "--save", str(tmp_path / "link" / file)]
        assert "it is a file of the recording; give another --save" in is_refused(arguments, capsys)
    assert {str(p.relative_to(room)) for p in room.rglob("*") if p.is_file()} == set(files_of("adagmm"))


def test_verify_replaces_no_file_of_the_recording(tmp_path, capsys):
    write_files(tmp_path, files_of("adagmm"))
    arguments = ["verify", str(tmp_path / "rig.yaml"), str(tmp_path), "--save", str(tmp_path / "recording.yaml")]
    assert "it is a file of the recording; give another --save" in is_refused(arguments, capsys)


@pytest.mark.parametrize("rig", ["room", "."])
def test_the_rig_of_a_simulation_is_not_its_folder(tmp_path, rig, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    error = is_refused(["simulate", "room/new", "--calibration", f"room/../{rig}"], capsys)
    assert "expected the name of a rig file" in error and not list(tmp_path.iterdir())


def test_a_picture_and_an_obj_replace_files_only(tmp_path):
    (tmp_path / "picture.jpg").symlink_to(os.devnull)
    with pytest.raises(OutputError, match="it is a link"):
        save_picture(tmp_path / "no.rrd", tmp_path / "picture.jpg")
    (tmp_path / "mesh.mtl").mkdir()
    with pytest.raises(OutputError, match=r"mesh\.mtl: expected a file to replace"):
        save_textured_mesh(tmp_path / "mesh.obj", tiny_mesh())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mesh.mtl", "picture.jpg"]


def tiny_mesh():
    import numpy as np

    from adagmm_fusion.meshes.textured_mesh import TexturedMesh

    corners = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    return TexturedMesh(
        corners,
        np.tile([0.0, 0.0, 1.0], (3, 1)),
        np.array([[0, 1, 2]], np.int32),
        corners[:, :2],
        np.zeros((4, 4, 3), np.uint8),
    )


def test_what_lies_in_a_linked_folder_is_not_taken_away(tmp_path, capsys):
    """`convert` empties what a killed run has left at a name that others can know."""
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "file.txt").write_text("precious")
    (tmp_path / ".copy.partial").symlink_to(tmp_path / "precious")
    is_refused(["convert", SHIPPED, str(tmp_path / "copy")], capsys)
    assert (tmp_path / "precious" / "file.txt").read_text() == "precious"
    with exclusive(tmp_path / ".copy.partial"):  # a folder of results may be a link
        pass
