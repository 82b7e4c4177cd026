"""The whole command where nothing is as on the desk it was written at: warnings are errors, the locale is C and the
output ASCII, the threads are few, the disk is full, and a worker of the cluster is killed."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from functools import partial

import pytest
from shared_data import ROOT
from tiny_recording import small_sensor

from adagmm_fusion.simulation.recording import simulate_recording

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits, mounts and locales of Linux"),
]
SHIPPED = str(ROOT / "recordings" / "two_kinects")
C_LOCALE = {"LC_ALL": "C", "LANG": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": ""}
ROOM_ON_DISK = "4m"  # less than one pair's clouds, more than a file's beginning


def run(*arguments, threads: int = 2, limit: int | None = None, warnings="error") -> subprocess.CompletedProcess:
    """`adagmm-fusion run` under `-W error` in the C locale; `limit` : bytes that no file may exceed."""
    command = [sys.executable, "-W", warnings, "-m", "adagmm_fusion", "run", *map(str, arguments), "--device", "cpu"]
    limited = None
    if limit is not None:
        limited = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    environment = os.environ | C_LOCALE | {"NUMBA_NUM_THREADS": str(threads)}
    return subprocess.run(command, capture_output=True, env=environment, preexec_fn=limited, timeout=600, check=False)


def pairs(folder) -> list[dict]:
    """The report's pairs without their times."""
    found = json.loads((folder / "report.json").read_text(encoding="utf-8"))["pairs"]
    return [{key: value for key, value in pair.items() if "seconds" not in key} for pair in found]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """By the number of threads: the folder and the ended process of a run over the shipped recording."""
    folder = tmp_path_factory.mktemp("whole")
    run(SHIPPED, "--pairs", "0", "--no-rerun", "--no-clouds", "--output", folder / "compiled")
    return {n: (folder / f"{n}", run(SHIPPED, "--output", folder / f"{n}", threads=n)) for n in (1, 2)}


@pytest.mark.parametrize("threads", [1, 2])
def test_nothing_warns_and_all_is_ascii(finished, threads):
    folder, process = finished[threads]
    assert process.returncode == 0, process.stderr
    assert process.stderr == b""
    out = process.stdout.decode("ascii")
    assert "3 of 3 pairs registered" in out and "rotation [deg]" in out and str(folder / "report.json") in out
    assert len(list((folder / "fused").iterdir())) == 6 and (folder / "two_kinects.rrd").stat().st_size > 1_000_000
    assert "‖I − R_gt R⁻¹‖" in (folder / "report.md").read_text(encoding="utf-8"), "files keep all letters"


def test_the_bits_do_not_depend_on_the_threads(finished):
    one, two = (pairs(finished[threads][0]) for threads in (1, 2))
    assert len(one) == 3 and [pair["T_target_source"] for pair in one] == [pair["T_target_source"] for pair in two]
    assert one == two
    for name in ("000000_right_to_left", "000001_right_to_left", "000002_right_to_left"):
        ply = [(finished[threads][0] / "fused" / f"{name}.ply").read_bytes() for threads in (1, 2)]
        assert ply[0] == ply[1]


def assert_ended_in_one_line(process, folder) -> str:
    """Our own line on stderr; beside it only what Rerun's writer says itself."""
    assert process.returncode == 1, process.stderr
    err = process.stderr.decode("ascii", errors="backslashreplace")
    assert "Traceback" not in err and process.stdout.count(b"Traceback") == 0
    lines = [line for line in err.splitlines() if line.startswith("adagmm-fusion: ")]
    assert len(lines) == 1, err
    assert not [path for path in folder.rglob(".*")], "what was being written is taken away"
    return lines[0]


@pytest.mark.parametrize("limit", [0, 1000, 2_000_000])
@pytest.mark.parametrize("more", [[], ["--no-rerun"]], ids=["rerun", "no rerun"])
def test_no_file_may_grow(tmp_path, limit, more):
    # Where it can make no semaphore, which is a file of 32 bytes, Numba warns and goes on.
    warnings = "error" if limit else "ignore"
    process = run(SHIPPED, "--output", tmp_path / "out", *more, limit=limit, warnings=warnings)
    line = assert_ended_in_one_line(process, tmp_path)
    assert "File too large" in line or "not all of it was written" in line


@pytest.fixture
def tiny_disk(tmp_path):
    """A file system without room."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={ROOM_ON_DISK}", "tmpfs", folder]
    mounted = shutil.which("mount") and subprocess.run(command, capture_output=True, check=False).returncode == 0
    if not mounted:
        pytest.skip("no file system can be mounted here; RLIMIT_FSIZE stands in for it above")
    yield folder
    subprocess.run(["umount", folder], check=True)


@pytest.mark.parametrize("more", [[], ["--no-rerun"]], ids=["rerun", "no rerun"])
def test_the_disk_is_full(tiny_disk, more):
    process = run(SHIPPED, "--output", tiny_disk / "out", *more)
    line = assert_ended_in_one_line(process, tiny_disk)
    assert "No space left on device" in line or "not all of it was written" in line
    # There is room for it, once the cloud and the recording that were too large are taken away.
    assert line.endswith(f"what was finished is in {tiny_disk / 'out' / 'report.json'}")
    assert len(pairs(tiny_disk / "out")) == 1
    assert "Rerun recording" not in (tiny_disk / "out" / "report.md").read_text(encoding="utf-8")


def test_a_recording_fills_the_disk(tiny_disk):
    """Rerun's writer notices by itself; all pairs are registered and reported, and the one line says what is lost."""
    process = run(SHIPPED, "--output", tiny_disk / "out", "--no-clouds")
    line = assert_ended_in_one_line(process, tiny_disk)
    assert len(pairs(tiny_disk / "out")) == 3
    assert "not all of it was written" in line or "No space left on device" in line
    assert not list(tiny_disk.rglob("*.rrd"))
    assert ".rrd" not in (tiny_disk / "out" / "report.md").read_text(encoding="utf-8")


def test_recordings_on_a_cluster_whose_worker_is_killed(tmp_path, monkeypatch):
    distributed = pytest.importorskip("distributed", reason="needs the [distributed] extra")
    small_sensor(monkeypatch)
    for name in ("a", "b", "c", "d"):
        simulate_recording(tmp_path / "rooms" / name, pairs=2, seed=ord(name))
    more = [tmp_path / "rooms", "--no-rerun", "--no-clouds", "--target-points", "500"]
    assert run(*more, "--output", tmp_path / "local", "--workers", "1").returncode == 0
    command = [sys.executable, "-m", "adagmm_fusion", "run", *map(str, more), "--output", str(tmp_path / "remote")]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
            pids = list(client.run(os.getpid).values())
        process = subprocess.Popen(
            [*command, "--device", "cpu", "--scheduler", cluster.scheduler_address],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        give_up = time.monotonic() + 120
        while not list((tmp_path / "remote").glob("*/report.json")) and time.monotonic() < give_up:
            assert process.poll() is None, "the run was to be caught in its middle"
            time.sleep(0.02)
        os.kill(pids[0], signal.SIGKILL)
        out, _ = process.communicate(timeout=300)
    assert process.returncode == 0, out
    for name in ("a", "b", "c", "d"):
        assert pairs(tmp_path / "remote" / name) == pairs(tmp_path / "local" / name)
