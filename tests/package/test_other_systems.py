"""Nothing of POSIX alone is in the way of an import, a registration, a journal or an interruption."""

import ast
import os
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import pytest
from shared_data import ROOT

from adagmm_bench.journal import Journal
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files import file_lock
from adagmm_fusion.files.journal_lines import sealed
from adagmm_fusion.processes import interruption

POSIX_MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "pty", "readline"}
POSIX_CALLS = {
    *("fork", "forkpty", "killpg", "getpgid", "setsid", "getuid", "geteuid", "mkfifo", "register_at_fork"),
    *("sched_setaffinity", "sched_getaffinity", "sysconf", "pthread_kill", "pthread_sigmask", "alarm", "setitimer"),
}
POSIX_NUMBERS = {
    *("O_NOFOLLOW", "O_NONBLOCK", "O_DIRECTORY", "O_CLOEXEC", "O_SYNC"),
    *("SIGHUP", "SIGKILL", "SIGQUIT", "SIGUSR1", "SIGALRM", "SIGCHLD", "SIGPIPE"),
}
# Where such a call is: behind a question whether there is one, or behind a file that only Linux has.
GUARDS = ("hasattr(", '"/proc/', "groups")
WITHOUT_POSIX = """
import builtins, os, signal, sys
find = builtins.__import__

def ours_find_none(name, globals=None, *rest, **more):
    if name in {modules!r} and str((globals or {{}}).get("__name__")).startswith("adagmm"):
        raise ModuleNotFoundError(name)
    return find(name, globals, *rest, **more)

builtins.__import__ = ours_find_none
import cv2, numba, open3d, rerun, rosbags, scipy.spatial  # may do as they like
for call in {calls!r}:
    for owner in (os, signal):
        if hasattr(owner, call):
            delattr(owner, call)
import numpy as np
import adagmm_bench.cli, adagmm_fusion.cli
from adagmm_o3d import register_points
points = np.random.default_rng(0).normal(size=(60, 3))
assert register_points(points, points).converged
adagmm_bench.cli.build_parser()
sys.exit(adagmm_fusion.cli.main({arguments!r}))
"""


@pytest.mark.slow
def test_posix_is_imported_and_called_behind_a_question_only():
    for path in [*(ROOT / "adagmm_o3d").rglob("*.py"), *(ROOT / "apps").rglob("*.py")]:
        source = path.read_text()
        lines = source.splitlines()
        tree = ast.parse(source)
        tried = [(n.lineno, n.end_lineno) for n in ast.walk(tree) if isinstance(n, ast.Try)]
        functions = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
        functions += [n for n in tree.body if isinstance(n, ast.If)]  # what a module asks when it is imported
        for node in ast.walk(tree):
            if isinstance(node, ast.Import) and POSIX_MODULES & {alias.name for alias in node.names}:
                assert any(first <= node.lineno <= last for first, last in tried), f"{path}:{node.lineno}"
            if isinstance(node, ast.Attribute) and node.attr in POSIX_CALLS | POSIX_NUMBERS:
                around = [f for f in functions if f.lineno <= node.lineno <= f.end_lineno]
                text = (
                    "\n".join(lines[around[0].lineno - 1 : around[0].end_lineno]) if around else lines[node.lineno - 1]
                )
                assert any(guard in text for guard in GUARDS), f"{path}:{node.lineno}: {node.attr}"


@pytest.mark.slow
def test_a_run_does_without_posix(tmp_path):
    arguments = [
        "run",
        str(ROOT / "recordings" / "two_kinects"),
        "--pairs",
        "0",
        "--no-clouds",
        "--target-points",
        "2000",
    ]
    arguments += ["--device", "cpu", "--output", str(tmp_path)]
    calls = sorted((POSIX_CALLS | POSIX_NUMBERS) - {"sysconf", "register_at_fork"})
    code = WITHOUT_POSIX.format(modules=sorted({"fcntl", "resource"}), calls=calls, arguments=arguments)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "1 of 1 pairs registered" in done.stdout


def test_a_journal_is_one_process_s_on_windows_too(tmp_path, monkeypatch):
    held = set()

    def locking(descriptor, mode, count):
        assert (mode, count) == ("nonblocking", 1)
        where = (os.fstat(descriptor).st_ino, os.lseek(descriptor, 0, os.SEEK_CUR))
        if where in held:
            raise PermissionError(13, "Permission denied")
        held.add(where)

    monkeypatch.setattr(file_lock, "fcntl", None)
    monkeypatch.setattr(file_lock, "msvcrt", SimpleNamespace(locking=locking, LK_NBLCK="nonblocking"))
    path = tmp_path / "results.jsonl"
    with Journal(path) as journal:
        journal.append({"key": "a"})
        with pytest.raises(OutputError, match="another run is writing here"):
            Journal(path)
    assert path.read_text() == sealed({"key": "a"}) + "\n"


@pytest.mark.parametrize("name", ["pthread_kill", "nothing"])
def test_a_signal_reaches_the_main_thread(name, monkeypatch):
    if name == "pthread_kill" and not hasattr(signal, name):
        pytest.skip("no pthread_kill here")
    if name == "nothing":
        monkeypatch.delattr(signal, "pthread_kill", raising=False)
    heard = []
    before = signal.signal(signal.SIGINT, lambda number, frame: heard.append(threading.current_thread()))
    try:
        threading.Timer(0.05, interruption._send_to_main_thread, (signal.SIGINT,)).start()
        give_up = time.monotonic() + 30
        while not heard and time.monotonic() < give_up:
            time.sleep(0.01)
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == [threading.main_thread()]
