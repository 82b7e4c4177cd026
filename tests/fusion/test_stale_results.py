"""A second run into the same folder: what the first one left is gone, and nothing else."""

import json

import numpy as np
import pytest
from shared_data import ROOT

from adagmm_fusion.cli import main
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.ply_file import ply_bytes
from adagmm_fusion.files.stale_results import (
    JOINT_SCHEMA,
    REPORTS,
    SCHEMA,
    check_not_foreign,
    is_marked,
    remove_files,
    remove_untouched,
    results_of_report,
    states_of,
)


def names(folder) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir()}


def write_all(folder, files: list[str]) -> None:
    for name in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")


def report(folder, results: dict, schema: str = SCHEMA) -> None:
    (folder / "report.json").write_text(json.dumps({"schema": schema, "results": results}))
    (folder / "report.md").write_text("x")


def test_what_the_report_names_goes_and_what_it_does_not_stays(tmp_path):
    write_all(tmp_path, ["fused/a.ply", "fused/a.glb", "fused/mine.ply", "rig.yaml", "room.rrd", "notes.txt"])
    report(tmp_path, {"cloud": "fused/a.ply", "mesh": "fused/a.glb", "rig": "rig.yaml", "rerun": "room.rrd"})
    remove_files(tmp_path, results_of_report(tmp_path))
    assert names(tmp_path) == {"fused/mine.ply", "notes.txt"}


@pytest.mark.parametrize(
    "name", ["../victim.ply", "/etc/passwd", "notes.txt", "fused/../notes.txt", 3, "fused/x/a.ply"]
)
def test_a_report_that_names_something_else_is_not_believed(tmp_path, name):
    folder = tmp_path / "out"
    write_all(tmp_path, ["victim.ply"])
    write_all(folder, ["notes.txt", "fused/x/a.ply"])
    report(folder, {"x": name})
    remove_files(folder, results_of_report(folder))
    assert names(tmp_path) == {"victim.ply", "out/notes.txt", "out/fused/x/a.ply"}


@pytest.mark.parametrize(
    "content", ["", "[]", "{", '{"schema": "other", "results": {}}', '{"schema": "adagmm-fusion-report"}']
)
def test_another_report_is_left_or_only_replaced(tmp_path, content):
    write_all(tmp_path, ["fused/a.ply"])
    (tmp_path / "report.json").write_text(content)
    remove_files(tmp_path, results_of_report(tmp_path))
    assert "fused/a.ply" in names(tmp_path)


def test_links_are_not_followed(tmp_path):
    write_all(tmp_path, ["elsewhere/a.ply"])
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "fused").symlink_to(tmp_path / "elsewhere")
    report(folder, {"x": "fused/a.ply"})
    remove_files(folder, results_of_report(folder))
    assert (tmp_path / "elsewhere" / "a.ply").is_file()


def test_what_cannot_be_removed_is_named(tmp_path, monkeypatch):
    write_all(tmp_path, ["mesh.ply"])

    def refuse(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(type(tmp_path), "unlink", refuse)
    with pytest.raises(OutputError, match=r"mesh\.ply: of an earlier run, cannot be removed: Permission denied"):
        remove_files(tmp_path, ["mesh.ply", "none.ply"])


def test_what_was_written_anew_stays(tmp_path):
    for name in ("old.ply", "new.ply"):
        (tmp_path / name).write_text("earlier")
    earlier = states_of(tmp_path, ["old.ply", "new.ply", "later.ply"])
    (tmp_path / "written").write_text("earlier")
    (tmp_path / "written").replace(tmp_path / "new.ply")
    (tmp_path / "later.ply").write_text("later")
    remove_untouched(tmp_path, earlier)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["later.ply", "new.ply"]


@pytest.mark.parametrize("name", [*REPORTS, "rig.yaml"])
def test_somebody_elses_file_is_not_replaced(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(OutputError, match=rf"{name}: is there already, and no earlier run has left it; move it, or"):
        check_not_foreign(tmp_path, [*REPORTS, "rig.yaml"], results_of_report(tmp_path))


RUN, FUSE, PLY, OBJ = ["run"], ["fuse"], ["fuse", "--mesh", "ply"], ["fuse", "--mesh", "obj"]
IN_PLACE = [
    (RUN, "fused/000000_right_to_left.ply"),
    (RUN, "fused/000002_right_to_left.glb"),
    (RUN, "two_kinects.rrd"),
    (FUSE, "two_kinects.rrd"),
    (FUSE, "trajectory_left.txt"),
    (FUSE, "mesh.glb"),
    (PLY, "mesh.ply"),
    (OBJ, "mesh.obj"),
    (OBJ, "mesh.mtl"),
    (OBJ, "mesh_0.png"),
]


@pytest.mark.parametrize(("arguments", "name"), IN_PLACE)
def test_somebody_elses_results_are_not_replaced(tmp_path, arguments, name, monkeypatch, capsys):
    """It is said before the work."""
    monkeypatch.setattr("adagmm_fusion.commands.run.compile_kernels", None)
    monkeypatch.setattr("adagmm_fusion.sequence.registration.register_scene", None)
    write_all(tmp_path, [name])
    assert main([*arguments, str(ROOT / "recordings" / "two_kinects"), "--output", str(tmp_path)]) == 1
    assert f"{tmp_path / name}: is there already, and no earlier run has left it" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "x" and names(tmp_path) == {name}


def test_somebody_elses_recording_of_all_is_not_replaced(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("adagmm_fusion.commands.run_many.run_tasks", None)
    many, out = tmp_path / "many", tmp_path / "out"
    many.mkdir()
    for name in ("a", "b"):
        (many / name).symlink_to(ROOT / "recordings" / "two_kinects")
    write_all(out, ["out.rrd"])
    assert main(["run", str(many), "--output", str(out)]) == 1
    assert f"{out / 'out.rrd'}: is there already, and no earlier run has left it" in capsys.readouterr().err
    assert names(out) == {"out.rrd"}


def test_what_a_killed_run_has_left_says_so_itself(tmp_path):
    points = np.zeros((1, 3))
    (tmp_path / "a.ply").write_bytes(ply_bytes(points, points))
    (tmp_path / "b.ply").symlink_to(tmp_path / "a.ply")
    (tmp_path / "a.yaml").write_bytes(ply_bytes(points, points))
    check_not_foreign(tmp_path, ["a.ply"], ())
    assert not is_marked(tmp_path / "b.ply") and not is_marked(tmp_path / "a.yaml")


@pytest.mark.parametrize("schema", [SCHEMA, JOINT_SCHEMA])
def test_what_an_earlier_run_has_left_is_replaced(tmp_path, schema):
    report(tmp_path, {"rig": "rig.yaml"}, schema)
    (tmp_path / "rig.yaml").write_text("x")
    check_not_foreign(tmp_path, [*REPORTS, "rig.yaml"], results_of_report(tmp_path))
    report(tmp_path, {}, schema)
    with pytest.raises(OutputError, match=r"rig\.yaml: is there already"):
        check_not_foreign(tmp_path, [*REPORTS, "rig.yaml"], results_of_report(tmp_path))
