"""A folder of many recordings, one task each."""

import json
import shutil

import pytest
from rerun.chunk import RrdReader
from shared_data import ROOT

from adagmm_fusion.cli import main
from adagmm_fusion.commands.run_many import recordings_in

pytestmark = pytest.mark.slow

SHIPPED = ROOT / "recordings" / "two_kinects"


@pytest.fixture
def folder(tmp_path):
    """Two copies of the shipped recording and its rig, one of them without images."""
    shutil.copytree(ROOT / "calibration", tmp_path / "calibration")
    many = tmp_path / "many"
    shutil.copytree(SHIPPED, many / "whole")
    shutil.copytree(SHIPPED, many / "broken")
    for image in [*(many / "broken").rglob("*.png"), *(many / "broken").rglob("*.jpg")]:
        image.unlink()
    (many / "notes").mkdir()
    return many


def test_recordings_are_found_among_subfolders(folder):
    assert [path.name for path in recordings_in(folder)] == ["broken", "whole"]
    assert recordings_in(folder / "whole") == []


def test_each_recording_gets_its_own_report(folder, tmp_path, capsys):
    output = tmp_path / "out"
    arguments = ["run", str(folder), "--output", str(output), "--workers", "2", "--no-clouds"]
    main(arguments)
    shown = capsys.readouterr().out
    whole = json.loads((output / "whole" / "report.json").read_text())
    assert [pair["status"] for pair in whole["pairs"]] == ["ok", "ok", "ok"]
    broken = json.loads((output / "broken" / "report.json").read_text())
    assert [pair["status"] for pair in broken["pairs"]] == ["failed"] * 3
    assert "whole" in shown and "broken" in shown
    joint = json.loads((output / "report.json").read_text())
    broken = joint["recordings"][0]
    assert (broken["name"], broken["summary"]["ok"], len(broken["failed"])) == ("broken", 0, 3)
    assert "## broken" in (output / "report.md").read_text().splitlines()
    assert len(RrdReader(output / "out.rrd").recordings()) == 3  # both, and the overview


def test_options_for_one_recording_are_refused(folder, capsys):
    assert main(["run", str(folder), "--pairs", "0", "--no-rerun"]) == 1
    assert "--pairs is for one" in capsys.readouterr().err
