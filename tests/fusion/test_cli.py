"""The command line: exit codes, one-line errors, results where they should be, and what an interruption leaves."""

import json
import math
import shutil
import subprocess
import sys
from dataclasses import replace

import numpy as np
import open3d as o3d
import pytest
from shared_data import ROOT
from tiny_recording import small_sensor

import adagmm_fusion.commands.run
from adagmm_fusion.cli import main
from adagmm_fusion.commands.run import selected_pairs, verdict
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import load_rig, save_rig
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import so_exp

SHIPPED = str(ROOT / "recordings" / "two_kinects")
QUICK = ["--target-points", "2000", "--device", "cpu"]


def command(*arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", *arguments], capture_output=True, text=True, timeout=300, check=False)


def content(folder) -> dict:
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def is_one_line(text: str) -> bool:
    return text.endswith("\n") and text.count("\n") == 1


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A run over the shipped recording as a user starts it."""
    folder = tmp_path_factory.mktemp("run") / "out"
    return folder, command("adagmm_fusion", "run", SHIPPED, "--output", str(folder), "--device", "cpu")


@pytest.mark.slow
def test_a_run_ends_well_and_says_where_its_results_are(finished):
    folder, process = finished
    assert process.returncode == 0, process.stderr
    # no progress bar where there is no terminal; who comes first has the kernels to compile
    assert [line for line in process.stderr.splitlines() if not line.startswith("compiling kernels")] == []
    assert "3 of 3 pairs registered" in process.stdout
    for name in ("report.md", "report.json", "rig.yaml", "two_kinects.rrd", "fused/000000_right_to_left.ply"):
        assert (folder / name).stat().st_size > 0
        assert str(folder / name) in process.stdout


@pytest.mark.slow
def test_the_results_fit_together(finished):
    folder, _ = finished
    report = content(folder)
    assert report["summary"]["ok"] == 3 and not report["interrupted"]
    assert report["summary"]["median"]["rotation_error_deg"] < 1.5
    assert set(report["results"].values()) == {
        "rig.yaml",
        "two_kinects.rrd",
        *(f"fused/00000{i}_right_to_left.{kind}" for i in range(3) for kind in ("ply", "glb")),
    }
    assert len(o3d.io.read_point_cloud(str(folder / "fused" / "000001_right_to_left.ply")).points) > 100_000
    assert command("rerun", "rrd", "verify", str(folder / "two_kinects.rrd")).returncode == 0
    assert not [path for path in folder.rglob(".*")]


@pytest.mark.slow
def test_the_estimated_rig_can_be_used_as_calibration(finished, tmp_path):
    folder, _ = finished
    recording = open_recording(SHIPPED, rig=load_rig(folder / "rig.yaml"))
    assert recording[0].T_target_source is not None
    arguments = ["run", SHIPPED, "--calibration", str(folder / "rig.yaml"), "--pairs", "1", "--no-rerun", "--no-clouds"]
    assert main([*arguments, "--output", str(tmp_path), *QUICK]) == 0
    report = content(tmp_path)
    assert report["recording"]["calibration"] == str(folder / "rig.yaml")
    assert report["pairs"][0]["translation_error_mm"] < 30.0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.json", "report.md", "rig.yaml"]


@pytest.mark.slow
def test_a_saved_rerun_file_goes_where_it_should(tmp_path):
    target = tmp_path / "elsewhere.rrd"
    arguments = [
        "run",
        SHIPPED,
        "--pairs",
        "0",
        "--no-clouds",
        "--save",
        str(target),
        "--output",
        str(tmp_path / "out"),
    ]
    assert main([*arguments, *QUICK]) == 0
    assert command("rerun", "rrd", "verify", str(target)).returncode == 0
    assert not list((tmp_path / "out").glob("*.rrd"))
    assert content(tmp_path / "out")["results"]["Rerun recording"] == "../elsewhere.rrd"


@pytest.mark.slow
def test_failed_pairs_are_shown_and_the_exit_code_says_that_all_are(tmp_path, capsys):
    arguments = ["run", SHIPPED, "--pairs", "0", "--no-rerun", "--no-clouds", "--max-rotation-error", "0.0001"]
    assert main([*arguments, "--output", str(tmp_path), *QUICK]) == 6
    assert "failed: 000000_right_to_left: rotation error" in capsys.readouterr().out
    assert content(tmp_path)["summary"] | {"median": None} == {
        "pairs_asked": 1,
        "pairs_done": 1,
        "ok": 0,
        "failed": 1,
        "median": None,
    }
    assert not (tmp_path / "rig.yaml").exists()


@pytest.mark.slow
def test_some_failed_pairs_are_an_error_where_that_is_asked_for(tmp_path, capsys):
    shutil.copytree(ROOT / "calibration", tmp_path / "calibration")
    recording = tmp_path / "recordings" / "two_kinects"
    shutil.copytree(SHIPPED, recording)
    (recording / "left" / "depth" / "000001.png").write_bytes(b"")
    arguments = ["run", str(recording), "--no-rerun", "--no-clouds", "--pairs", "0,1", *QUICK]
    assert main([*arguments, "--output", str(tmp_path / "lenient")]) == 0
    assert main([*arguments, "--output", str(tmp_path / "strict"), "--strict"]) == 5
    assert "1 of 2 pairs registered" in capsys.readouterr().out
    many = ["run", str(recording.parent), "--no-rerun", "--no-clouds", "--workers", "1", *QUICK]
    assert main([*many, "--output", str(tmp_path / "many"), "--strict"]) == 5


@pytest.mark.slow
def test_a_rig_that_has_changed_since_it_was_calibrated_is_said(tmp_path, capsys):
    rig = load_rig(ROOT / "calibration" / "two_kinects.yaml")
    turned = np.array(rig.sensors["right"].T_rig_sensor)
    turned[:3, :3] = turned[:3, :3] @ so_exp((0.0, math.radians(2.7), 0.0))
    right = replace(rig.sensors["right"], T_rig_sensor=turned)
    save_rig(tmp_path / "stale.yaml", replace(rig, sensors=rig.sensors | {"right": right}))
    arguments = ["run", SHIPPED, "--calibration", str(tmp_path / "stale.yaml"), "--no-rerun", "--no-clouds", *QUICK]
    assert main([*arguments, "--pairs", "0,1", "--output", str(tmp_path / "out")]) == 0
    assert "note: all 2 pairs of right and left differ from their given pose by the same 2.7" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("ok", "pairs", "lenient", "strict"), [(3, 3, 0, 0), (2, 3, 0, 5), (1, 3, 0, 5), (0, 3, 6, 6), (0, 0, 0, 0)]
)
def test_the_exit_code_follows_from_the_pairs(ok, pairs, lenient, strict):
    assert verdict(ok, pairs, strict=False) == lenient
    assert verdict(ok, pairs, strict=True) == strict


@pytest.mark.slow
def test_an_interruption_keeps_what_was_finished(tmp_path, monkeypatch, capsys):
    run_pairs = adagmm_fusion.commands.run.run_pairs

    def interrupted_after_one(*arguments):
        yield next(run_pairs(*arguments))
        raise KeyboardInterrupt

    monkeypatch.setattr(adagmm_fusion.commands.run, "run_pairs", interrupted_after_one)
    assert main(["run", SHIPPED, "--no-clouds", "--output", str(tmp_path), *QUICK]) == 130
    report = content(tmp_path)
    assert report["interrupted"] is True
    assert (report["summary"]["pairs_asked"], report["summary"]["pairs_done"]) == (3, 1)
    assert "interrupted, 2 of 3 not tried" in capsys.readouterr().out
    assert command("rerun", "rrd", "verify", str(tmp_path / "two_kinects.rrd")).returncode == 0


@pytest.mark.slow
def test_a_crash_keeps_the_report_and_is_not_hidden(tmp_path, monkeypatch):
    run_pairs = adagmm_fusion.commands.run.run_pairs

    def crashing_after_one(*arguments):
        yield next(run_pairs(*arguments))
        raise ZeroDivisionError

    monkeypatch.setattr(adagmm_fusion.commands.run, "run_pairs", crashing_after_one)
    with pytest.raises(ZeroDivisionError):
        main(["run", SHIPPED, "--no-clouds", "--no-rerun", "--output", str(tmp_path), *QUICK])
    assert content(tmp_path)["summary"]["pairs_done"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "no/such/recording"], "no/such/recording: there is no such recording"),
        (["run", SHIPPED, "--pairs", "3"], "--pairs: expected ranges within 0-2"),
        (["run", SHIPPED, "--calibration", "no.yaml"], "no.yaml: "),
        (["run", SHIPPED, "--voxel-size", "-1"], "voxel_size_m: expected a positive number"),
        (["run", SHIPPED, "--step", "0"], "step: expected a positive number of frames"),
        (["simulate", str(ROOT)], "not an empty folder"),
    ],
)
def test_known_errors_are_one_line_on_stderr(arguments, message, capsys):
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == "" and is_one_line(err)
    assert err.startswith("adagmm-fusion: ") and message in err


@pytest.mark.parametrize("name", ["a" * 300, "d/" * 3000 + "d"], ids=["a name", "a path"])
@pytest.mark.parametrize(
    "arguments",
    [
        ["info", "NAME"],
        ["run", "NAME"],
        ["fuse", "NAME"],
        ["verify", str(ROOT / "calibration" / "two_kinects.yaml"), "NAME"],
        ["calibrate", "--from-scene", "NAME", "--output", "rig.yaml"],
        ["convert", "NAME", "out"],
        ["convert", SHIPPED, "NAME"],
        ["simulate", "NAME"],
        ["run", SHIPPED, "--output", "NAME", *QUICK],
        ["run", SHIPPED, "--save", "NAME", *QUICK],
        ["run", SHIPPED, "--config", "NAME"],
        ["run", SHIPPED, "--calibration", "NAME"],
    ],
    ids=" ".join,
)
def test_a_name_that_is_too_long_is_one_line_on_stderr(arguments, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([name if argument == "NAME" else argument for argument in arguments]) in (1, 2)
    err = capsys.readouterr().err.strip().splitlines()[-1]
    assert err.startswith("adagmm-fusion") and "File name too long" in err


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_is_one_line_on_stderr(tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert main(["run", SHIPPED, "--pairs", "0", "--no-rerun", "--output", str(tmp_path / "file"), *QUICK]) == 1
    err = capsys.readouterr().err
    assert is_one_line(err) and str(tmp_path / "file") in err


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fly"],
        ["run"],
        ["run", SHIPPED, "--format", "unheard-of"],
        ["run", SHIPPED, "--target-points", "many"],
        ["run", SHIPPED, "--sensor-model", "sonar"],
        ["simulate"],
    ],
)
def test_wrong_usage_exits_with_2(arguments, capsys):
    with pytest.raises(SystemExit) as leaving:
        main(arguments)
    assert leaving.value.code == 2
    assert "usage: adagmm-fusion" in capsys.readouterr().err


@pytest.mark.slow
def test_simulate_makes_a_recording_that_run_takes(tmp_path, monkeypatch, capsys):
    small_sensor(monkeypatch)
    assert main(["simulate", str(tmp_path / "room"), "--pairs", "1", "--seed", "5"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'room'}: 1 pair(s), rig {tmp_path / 'room' / 'rig.yaml'}\n"
    arguments = ["run", str(tmp_path / "room"), "--no-rerun", "--no-clouds", "--output", str(tmp_path / "out")]
    assert main([*arguments, *QUICK]) == 0
    assert content(tmp_path / "out")["recording"]["name"] == "room"


@pytest.mark.parametrize(
    ("text", "indices"),
    [(None, [0, 1, 2, 3, 4]), ("2", [2]), ("4,0-2", [4, 0, 1, 2]), ("1, 1-2", [1, 2]), ("0-4", [0, 1, 2, 3, 4])],
)
def test_pairs_are_chosen_by_number(text, indices):
    assert selected_pairs(text, 5) == indices


@pytest.mark.parametrize("text", ["", "a", "1-", "-1", "1-b", "2-1", "5", "0-5", "0,,1", "1.5"])
def test_other_choices_are_refused(text):
    with pytest.raises(InputError, match=r"^--pairs: expected"):
        selected_pairs(text, 5)


def test_the_version_is_told(capsys):
    with pytest.raises(SystemExit) as leaving:
        main(["--version"])
    assert leaving.value.code == 0
    assert capsys.readouterr().out.startswith("adagmm-fusion 0.")


def test_settings_are_dumped_and_taken_again(tmp_path, capsys):
    given = ["--target-points", "2000", "--voxel-size", "0.07", "--start", "geometry", "--min-overlap", "0.25"]
    assert main(["run", SHIPPED, *given, "--dump-config"]) == 0
    text = capsys.readouterr().out
    assert "target_points: 2000\n" in text and "# max_iteration: chosen as fits\n" in text
    file = tmp_path / "settings.yaml"
    file.write_text(text)
    assert main(["run", SHIPPED, "--config", str(file), "--dump-config"]) == 0
    assert capsys.readouterr().out == text
    assert main(["run", SHIPPED, f"--config={file}", "--voxel-size", "0.08", "--dump-config"]) == 0
    assert capsys.readouterr().out == text.replace("0.07", "0.08")


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("voxel: 1\n", 1, "settings.yaml:1: voxel: unknown key 'voxel'; known here: sensor_model, "),
        ("voxel_size_m: 1\nvoxel_size_m: 2\n", 1, "settings.yaml:2: "),
        ("- 1\n", 1, "expected a mapping"),
        ("target_points: many\n", 2, "argument --target-points: invalid int value: 'many'"),
        ("sensor_model: sonar\n", 2, "argument --sensor-model: invalid choice: 'sonar'"),
        ("max_depth_m: -1\n", 1, "max_depth_m: expected a positive number, got -1.0"),
    ],
)
def test_wrong_settings_files_are_errors(text, code, message, tmp_path, capsys):
    file = tmp_path / "settings.yaml"
    file.write_text(text)
    arguments = ["run", SHIPPED, "--config", str(file), "--dump-config"]
    if code == 2:
        with pytest.raises(SystemExit) as leaving:
            main(arguments)
        assert leaving.value.code == 2
    else:
        assert main(arguments) == code
    out, err = capsys.readouterr()
    assert out == "" and message in err


@pytest.mark.slow
def test_a_run_can_be_quiet(tmp_path, capsys):
    arguments = ["run", SHIPPED, "--pairs", "0", "--no-rerun", "--no-clouds", "--output", str(tmp_path), *QUICK]
    assert main([*arguments, "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert content(tmp_path)["summary"]["ok"] == 1
