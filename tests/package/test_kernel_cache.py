"""A registration where Numba finds no place for compiled kernels, and kernels that are compiled ahead."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "adagmm_o3d"
REGISTER = """
import numpy as np, adagmm_o3d
points = np.random.default_rng(0).normal(size=(60, 3))
print(adagmm_o3d.__file__)
print(adagmm_o3d.register_points(points, points).converged)
"""
# Which kernels that are kept on disk have not been compiled.
LEFT = """
import gc, logging
logging.disable()
from adagmm_o3d.warm_up import warm_up
warm_up()
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher
kept = [d for d in gc.get_objects() if isinstance(d, Dispatcher) and not isinstance(d._cache, NullCache)]
wanted = {"run_em": 2, "convolution_sums": 2, "score_sums": 2}  # with colours and without
names = [(d.py_func.__name__, len(d.signatures)) for d in kept]
print(len(kept), [name for name, count in names if count != wanted.get(name, 1)])
"""


@pytest.fixture
def nowhere(tmp_path):
    """A copy of the package that nobody may write to, without kernels; its folder and the environment of a process.

    Root may write anywhere, so `__pycache__` and the home's cache are files, in which no folder can be made.
    """
    site = tmp_path / "site"
    copy = site / "adagmm_o3d"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    home, temporary = tmp_path / "home", tmp_path / "temporary"
    home.mkdir()
    temporary.mkdir()
    (home / ".cache").write_text("")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_CACHE", "XDG_"))}
    environment |= {
        "PYTHONPATH": str(site),
        "HOME": str(home),
        "TMPDIR": str(temporary),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    return copy, environment


def close(package):
    for folder in [package, *package.rglob("*")]:
        if folder.is_dir() and folder.name != "__pycache__" and not (folder / "__pycache__").exists():
            (folder / "__pycache__").write_text("")


def run(code, environment, folder):
    return subprocess.run([sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True)


def kernels_said(done):
    return [line for line in done.stderr.splitlines() if "kernels" in line and not line.startswith("compiling")]


@pytest.mark.slow
def test_kernels_are_kept_in_a_temporary_folder_and_one_line_says_so(nowhere, tmp_path):
    package, environment = nowhere
    close(package)
    done = run(REGISTER, environment, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [str(package / "__init__.py"), "True"]
    (line,) = kernels_said(done)
    (folder,) = (tmp_path / "temporary").glob("adagmm_o3d-kernels-*")
    assert line == f"compiled kernels are kept in {folder}, as Numba's cache cannot be written: see NUMBA_CACHE_DIR"
    assert folder.stat().st_mode & 0o077 == 0
    again = run(REGISTER, environment, tmp_path)
    assert again.returncode == 0 and "compiling" in done.stderr and "compiling" not in again.stderr


@pytest.mark.slow
def test_a_temporary_folder_of_somebody_elses_is_not_used(nowhere, tmp_path):
    package, environment = nowhere
    close(package)
    expected = tmp_path / "temporary" / f"adagmm_o3d-kernels-{os.getuid()}"
    expected.mkdir()
    expected.chmod(0o777)
    done = run(REGISTER, environment, tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(kernels_said(done)) == 1 and f"{expected}," not in done.stderr
    assert list((tmp_path / "temporary").iterdir()) == [expected] and not list(expected.iterdir())


@pytest.mark.slow
def test_without_any_folder_kernels_are_compiled_and_not_kept(nowhere, tmp_path):
    package, environment = nowhere
    close(package)
    deny = "import tempfile\ndef deny(*_, **__): raise OSError('read-only file system')\ntempfile.gettempdir = deny\n"
    done = run(
        deny + "import numba.core.caching as c\nc.tempfile.TemporaryFile = deny\n" + REGISTER, environment, tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert kernels_said(done) == [
        "no folder for compiled kernels can be written, each process compiles them: set NUMBA_CACHE_DIR"
    ]


@pytest.mark.slow
def test_kernels_compiled_ahead_are_found_where_nothing_can_be_written(nowhere, tmp_path):
    package, environment = nowhere
    warm = subprocess.run(
        [sys.executable, "-m", "adagmm_o3d.warm_up"], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert warm.returncode == 0 and "compiling" in warm.stderr, warm.stderr
    # what a closed folder does to Numba's own way of asking whether it may write
    shut = (
        "import tempfile\nfrom numba.core import caching\nmake = tempfile.TemporaryFile\n"
        "def shut(*, dir):\n"
        f"    if str(dir).startswith({str(package)!r}): raise PermissionError(13, 'Permission denied')\n"
        "    return make(dir=dir)\n"
        "caching.tempfile.TemporaryFile = shut\n"
    )
    done = run(shut + REGISTER, environment, tmp_path)
    assert done.returncode == 0, done.stderr
    assert len(kernels_said(done)) == 1 and "compiling" not in done.stderr, done.stderr


@pytest.mark.slow
def test_warming_up_leaves_nothing_to_compile():
    done = subprocess.run([sys.executable, "-c", LEFT], capture_output=True, text=True, check=True)
    count, left = done.stdout.split(maxsplit=1)
    assert int(count) >= 8 and left.strip() == "[]", done.stdout
