"""A user's strict type check sees our types: of results, of `.details`, and of arguments that are wrong."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from typing import get_args

import pytest
from shared_data import ROOT

from adagmm_o3d.options import DeviceName
from adagmm_o3d.pairs.device import DEVICES

pytest.importorskip("mypy", reason="needs mypy")

GOOD = ROOT / "tests" / "support" / "typed_script.py"
RESULT, ARRAY = (
    "adagmm_o3d.result.PointRegistrationResult",
    "numpy.ndarray[tuple[Any, ...], numpy.dtype[numpy.float64]]",
)
REVEALED = [RESULT, ARRAY, f"{ARRAY} | None", RESULT, "float", RESULT, RESULT, "int"]
BAD = """\
import open3d as o3d
from adagmm_o3d import prepare, register_points, registration_adaptive_gmm
cloud = o3d.geometry.PointCloud()
tensor = o3d.t.geometry.PointCloud()
registration_adaptive_gmm(cloud, tensor, 0.05)
registration_adaptive_gmm(cloud, cloud, 0.05, device="gpu")
registration_adaptive_gmm(cloud, cloud, 0.05, criteria=3)
registration_adaptive_gmm("cloud", cloud, 0.05)
register_points([[0.0]], [[0.0]], estimation_method="icp")
register_points([[0.0]], [[0.0]], device=0)
registration_adaptive_gmm(tensor, tensor, 0.05).details.overlop
prepare(cloud, [[[1.0]]])
registration_adaptive_gmm(tensor, prepare(cloud), 0.05)
"""
WRONG = set(range(5, len(BAD.splitlines()) + 1))


@pytest.fixture(scope="module")
def checked(tmp_path_factory):
    """What mypy says of the good script and of the bad one, and the bad one's path."""
    folder = tmp_path_factory.mktemp("typing")
    bad = folder / "bad.py"
    bad.write_text(BAD)
    options = [
        "--config-file=",
        "--strict",
        "--follow-imports=silent",
        f"--cache-dir={folder / 'cache'}",
        "--no-pretty",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *options, str(GOOD), str(bad)],
        env=os.environ | {"MYPYPATH": str(ROOT)},
        cwd=folder,
        capture_output=True,
        text=True,
    )
    return done.stdout, bad


@pytest.mark.slow
def test_a_strict_script_has_no_errors_and_its_results_have_types(checked):
    said = [line for line in checked[0].splitlines() if "typed_script.py" in line]
    assert not [line for line in said if "error:" in line], said
    assert [re.search(r'Revealed type is "(.*)"', line)[1] for line in said if "Revealed" in line] == REVEALED


@pytest.mark.slow
def test_wrong_arguments_are_errors(checked):
    out, bad = checked
    wrong = {int(line.split(":")[1]) for line in out.splitlines() if f"{bad.name}:" in line and "error:" in line}
    assert wrong == WRONG


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("pyright") is None, reason="needs pyright")
def test_pyright_agrees(tmp_path):
    (tmp_path / "bad.py").write_text(BAD)
    (tmp_path / "good.py").write_text(GOOD.read_text())
    settings = {"typeCheckingMode": "strict", "extraPaths": [str(ROOT)], "include": ["*.py"]}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--outputjson"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    said = json.loads(done.stdout)["generalDiagnostics"]
    errors = [(os.path.basename(d["file"]), d["range"]["start"]["line"] + 1) for d in said if d["severity"] == "error"]
    assert set(errors) == {("bad.py", line) for line in WRONG}, said
    revealed = [d["message"].rpartition(" is ")[2].strip('"') for d in said if d["severity"] == "information"]
    short = [re.sub(r"\b(numpy|adagmm_o3d\.result)\.", "", kind) for kind in REVEALED]
    assert revealed == short


def test_the_type_of_a_device_names_the_devices():
    assert get_args(DeviceName) == DEVICES
