"""What the demo and the tests share to set themselves up: run with stand-ins for pip, dpkg, apt and the user's id."""

import os
import shutil
import subprocess

import pytest
from shared_data import ROOT

pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")


@pytest.fixture
def clone(tmp_path):
    """A folder like a fresh clone, with a `.venv` whose python writes down what it is asked to do."""
    for file in ("apps/system_packages.sh", "apps/demo.sh", "pyproject.toml", "adagmm_o3d/version.py"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    stand_in(tmp_path / ".venv" / "bin" / "python", f'echo "$@" >>{tmp_path}/asked\n[ "$5" != open3d-cpu ]')
    return tmp_path


def stand_in(path, script):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/bash\n{script}\n")
    path.chmod(0o755)


def outside() -> dict[str, str]:
    """The environment without what somebody has chosen there."""
    return {name: value for name, value in os.environ.items() if not name.startswith("ADAGMM_")}


def bash(clone, script, **environment):
    path = f"{clone / 'stand_ins'}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        ["bash", "-c", f"set -euo pipefail\nsource apps/system_packages.sh\n{script}"],
        cwd=clone,
        env=outside() | {"PATH": path} | environment,
        capture_output=True,
        text=True,
    )


def installs(clone):
    lines = (clone / "asked").read_text().splitlines()
    return [line.rpartition(" ")[2] for line in lines if " install " in line]


def test_what_is_there_is_not_installed_again(clone):
    for _ in range(2):
        assert bash(clone, "install_project apps").returncode == 0
    assert installs(clone) == [".[apps,open3d]"]
    bash(clone, "install_project dev")
    assert installs(clone)[1:] == [".[dev,open3d]"]
    with open(clone / "pyproject.toml", "a") as file:
        file.write("\n")
    bash(clone, "install_project apps")
    assert installs(clone)[2:] == [".[apps,open3d]"]


def test_an_installation_that_failed_is_tried_again(clone):
    stand_in(clone / ".venv" / "bin" / "python", f'echo "$@" >>{clone}/asked\nexit 1')
    for _ in range(2):
        assert bash(clone, "install_project apps").returncode != 0
    assert installs(clone) == [".[apps,open3d]"] * 2


def test_the_smaller_open3d_is_taken_where_it_is_asked_for_or_there(clone):
    bash(clone, "install_project apps", ADAGMM_OPEN3D="open3d-cpu")
    assert installs(clone) == [".[apps,open3d-cpu]"]
    stand_in(clone / ".venv" / "bin" / "python", f'echo "$@" >>{clone}/asked')  # pip show finds open3d-cpu
    bash(clone, "install_project dev")
    assert installs(clone)[1:] == [".[dev,open3d-cpu]"]


@pytest.fixture
def debian(clone):
    """Debian without libegl1 and libvulkan1, for a user who is not root."""
    missing = '[[ "${@: -1}" =~ ^(libegl1|libvulkan1)$ ]] || echo install ok installed'
    stand_in(clone / "stand_ins" / "dpkg-query", missing)
    stand_in(clone / "stand_ins" / "id", "echo 1000")
    stand_in(clone / "stand_ins" / "apt-get", f"echo apt-get >>{clone}/asked")
    return clone


def test_missing_libraries_are_told_before_anything_is_downloaded_and_last(debian):
    done = bash(debian, 'install_system_packages "$LIBRARIES"; install_project apps')
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == "system libraries are missing: sudo apt-get install libegl1"
    assert not (debian / "asked").exists()


def test_libraries_that_come_from_elsewhere_are_believed(debian):
    script = 'install_system_packages "$LIBRARIES"; install_project apps; echo reached; false'
    done = bash(debian, script, ADAGMM_SYSTEM_LIBRARIES="mine")
    assert done.stdout.endswith("reached\n") and installs(debian) == [".[apps,open3d]"]
    assert done.stderr.splitlines()[-1] == "system libraries are missing: sudo apt-get install libegl1"


def test_what_only_the_viewers_tests_need_stops_nothing(debian):
    stand_in(debian / "stand_ins" / "dpkg-query", '[ "${@: -1}" = libvulkan1 ] || echo install ok installed')
    done = bash(debian, 'install_system_packages "$LIBRARIES $VIEWER_LIBRARIES"; echo reached')
    assert done.returncode == 0 and done.stdout == "reached\n"
    assert done.stderr == "not root, so not installed: libvulkan1; what needs them will be skipped\n"


def test_root_installs_them(debian):
    stand_in(debian / "stand_ins" / "id", "echo 0")
    done = bash(debian, 'install_system_packages "$LIBRARIES"; echo reached')
    assert done.returncode == 0 and done.stdout == "installing libegl1\nreached\n"
    assert (debian / "asked").read_text() == "apt-get\napt-get\n"


def test_what_root_has_installed_is_not_missing_when_something_else_fails(debian):
    stand_in(debian / "stand_ins" / "id", "echo 0")
    done = bash(debian, 'install_system_packages "$LIBRARIES"; false')
    assert done.returncode == 1 and done.stderr == ""


def test_what_apt_could_not_install_is_told_last(debian):
    stand_in(debian / "stand_ins" / "id", "echo 0")
    stand_in(debian / "stand_ins" / "apt-get", 'echo "no network" >&2; exit 100')
    done = bash(debian, 'install_system_packages "$LIBRARIES"; install_project apps')
    assert done.returncode == 100
    assert done.stderr.splitlines()[-1] == "system libraries are missing: sudo apt-get install libegl1"
    assert not (debian / "asked").exists()


def test_the_demo_runs_without_a_network_once_it_is_set_up(debian):
    stand_in(debian / "stand_ins" / "dpkg-query", "echo install ok installed")
    stand_in(debian / ".venv" / "bin" / "adagmm-fusion", f'echo "adagmm-fusion $@" >>{debian}/asked')
    command = ["bash", "apps/demo.sh", "--no-rerun"]
    for _ in range(2):
        done = subprocess.run(command, cwd=debian, env=outside() | {"PATH": f"{debian}/stand_ins:{os.environ['PATH']}"})
        assert done.returncode == 0
    asked = (debian / "asked").read_text().splitlines()
    assert installs(debian) == [".[apps,open3d]"]
    assert asked.count("-m adagmm_o3d.warm_up") == 2
    assert asked[-1] == "adagmm-fusion run recordings/two_kinects --output output/two_kinects --no-rerun"
