"""Readers, sensor models and bench methods of other packages, installed and what is wrong with some."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from shared_data import ROOT

from adagmm_o3d import InputError
from adagmm_o3d.entry_points import entry_points

EXAMPLES = ROOT / "examples" / "extensions"
SHIPPED = ROOT / "recordings" / "two_kinects"


def install(site: Path, name: str, groups: str, module: str | None = None) -> None:
    """What pip leaves of a package with one module: the module, and a folder with its entry points."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(groups)
    if module is not None:
        (site / f"{name}.py").write_text(module)


@pytest.fixture
def site(tmp_path):
    """A folder on the path with the three examples, with the entry points that their docstrings tell."""
    folder = tmp_path / "site"
    for example in sorted(EXAMPLES.glob("*.py")):
        text = example.read_text()
        group, entry = re.search(r'\[project\.entry-points\."([a-z0-9_.]+)"\]\n    (.+)\n', text).groups()
        install(folder, example.stem, f"[{group}]\n{entry.replace(chr(34), '')}\n", text)
    return folder


def run(site, *arguments, cwd=None):
    path = os.pathsep.join([str(site), *sys.path])
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.run([sys.executable, *arguments], env=environment, cwd=cwd, capture_output=True, text=True)


@pytest.mark.slow
def test_a_format_and_a_sensor_model_of_others_are_used_as_ours_are(site, tmp_path):
    recording = tmp_path / "numbered"
    recording.mkdir()
    for number, sensor in enumerate(("left", "right")):
        shutil.copy(SHIPPED / sensor / "color" / "000000.jpg", recording / f"{number}.jpg")
        shutil.copy(SHIPPED / sensor / "depth" / "000000.png", recording / f"{number}.png")
    rig = ROOT / "calibration" / "two_kinects.yaml"
    one = tmp_path / "rig.yaml"
    one.write_text(rig.read_text().split("  right:")[0].split('  "right":')[0])
    arguments = [
        "run",
        str(recording),
        "--calibration",
        str(one),
        "--sensor-model",
        "my-tof",
        "--no-clouds",
        "--no-rerun",
    ]
    arguments += ["--output", str(tmp_path / "out"), "--target-points", "2000", "--device", "cpu"]
    done = run(site, "-m", "adagmm_fusion", *arguments)
    assert done.returncode == 0, done.stderr + done.stdout
    assert "1 of 1 pairs registered" in done.stdout
    assert '"format": "numbered"' in (tmp_path / "out" / "report.json").read_text()
    without = run(tmp_path, "-m", "adagmm_fusion", *arguments)
    assert without.returncode == 2 and "'my-tof'" in without.stderr


@pytest.mark.slow
def test_a_method_of_others_is_listed_and_runs(site, tmp_path):
    listed = run(site, "-m", "adagmm_bench", "methods")
    assert "centroids-only [2D/3D, only where named] numpy" in listed.stdout, listed.stderr
    arguments = ["sim2d", "--trials", "1", "--sweeps", "noise", "--methods", "centroids-only", "--starts", "as-given"]
    arguments += ["--workers", "1", "--output", str(tmp_path / "out"), "--data", str(tmp_path)]
    done = run(site, "-m", "adagmm_bench", *arguments)
    assert done.returncode == 0, done.stderr
    assert "centroids-only" in done.stdout


@pytest.mark.slow
def test_what_cannot_be_used_is_one_line_that_names_its_package(tmp_path):
    install(tmp_path, "broken", "[adagmm_o3d.sensor_models]\nbad = broken:model\n", "raise OSError('no\\nlicence')\n")
    install(tmp_path, "empty", "[adagmm_fusion.formats]\nhollow = empty\n", "")
    install(tmp_path, "absent", "[adagmm_bench.methods]\nlost = absent\n")
    shaped = "import numpy\n\ndef model(points, normals, focal_lengths):\n    return numpy.eye(3)\n"
    install(tmp_path, "shaped", "[adagmm_o3d.sensor_models]\nwrong = shaped:model\n", shaped)
    arguments = ["run", str(SHIPPED), "--pairs", "0", "--no-rerun", "--no-clouds", "--output", str(tmp_path / "out")]
    sensor = "'bad' of adagmm_o3d.sensor_models: broken:model of broken cannot be used (OSError: no licence)"
    hollow = "format 'hollow': expected empty to have SUMMARY and matches and read"
    for option, code, message in (
        (["--sensor-model", "bad"], 6, f"entry point {sensor}"),
        (["--sensor-model", "wrong"], 6, "covariances of the sensor model 'wrong': expected shape"),
        (["--format", "hollow"], 1, f"adagmm-fusion: {hollow}"),
    ):
        done = run(tmp_path, "-m", "adagmm_fusion", *arguments, *option)
        assert done.returncode == code and "Traceback" not in done.stderr
        assert message in done.stderr + done.stdout, done.stderr + done.stdout
        assert f"format 'hollow' is not looked for: {hollow}" in done.stderr
    listed = run(tmp_path, "-m", "adagmm_bench", "methods")
    assert listed.returncode == 0
    assert "entry point 'lost' of adagmm_bench.methods: absent of absent cannot be used" in listed.stdout


def test_a_name_is_not_given_twice(tmp_path, monkeypatch):
    install(tmp_path, "one", "[a.group]\nsame = one\n")
    install(tmp_path, "two", "[a.group]\nsame = two\n[another.group]\nours = two\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(
        InputError,
        match=r"^entry point 'same' of a.group: expected a name of its own, but (one and two|two and one) have it",
    ):
        entry_points("a.group")
    with pytest.raises(InputError, match=r"^entry point 'ours' of another.group: .* but two and adagmm_o3d have it"):
        entry_points("another.group", ("ours",))
