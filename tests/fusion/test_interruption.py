"""Killed, interrupted, out of room, started twice: what was finished is intact, the exit code is right, and a command
that is started again ends as if nothing had happened."""

import importlib
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from depth_scene import camera_pose, write_pose_file

from adagmm_bench.journal import Journal
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.image_files import read_color
from adagmm_fusion.files.output_folder import exclusive
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.processes.interruption import Terminated, signals_as_interrupts
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.recordings.writer import convert_recording

pytestmark = [
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, limits and signals of Linux"),
    pytest.mark.slow,
]

if sys.platform.startswith("linux"):
    from killable import Killable

INTRINSICS = PinholeIntrinsics(80, 60, 70.0, 70.0, 39.5, 29.5)
POSES = [camera_pose(5.0 * i - 10.0, (0.03 * i, 0.05 * i, 1.2)) for i in range(5)]
BENCH = ["adagmm-bench", "sim2d", "--trials", "1", "--sweeps", "noise", "--starts", "centroids"]
BENCH += ["--methods", "open3d-gicp-covariances,open3d-point-to-plane"]
KILLS = {"fuse": 34, "run": 33, "bench": 33}
CODES = {signal.SIGKILL: -signal.SIGKILL, signal.SIGTERM: 143, signal.SIGINT: 130}


@pytest.fixture(scope="module")
def killable():
    server = Killable()
    yield server
    server.close()


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk") / "room"
    write_pose_file(folder, POSES, INTRINSICS)
    return folder


def command(name: str, room: Path, output: Path) -> list:
    return {
        "fuse": ["adagmm-fusion", "fuse", room, "--voxel-size", "0.05", "--device", "cpu", "--output", output],
        "run": ["adagmm-fusion", "run", room, "--target-points", "500", "--device", "cpu", "--output", output],
        "bench": [*BENCH, "--data", room, "--output", output],
        "convert": ["adagmm-fusion", "convert", room, output],
        "simulate": ["adagmm-fusion", "simulate", output, "--pairs", "1"],
    }[name]


def without_times(value):
    """JSON data without what differs from run to run: times, and the check of a line, which is of its times too."""
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if "seconds" not in k and k != "check"}
    return [without_times(v) for v in value] if isinstance(value, list) else value


def content(path: Path):
    """What is in a result; fails if it is not whole."""
    if path.suffix == ".json":
        return without_times(json.loads(path.read_text()))
    if path.suffix == ".jsonl":
        lines = path.read_text().split("\n")[:-1]  # what follows the last line's end is being written
        return [without_times(json.loads(line)) for line in lines]
    if path.suffix == ".png":
        return read_color(path).shape
    if path.suffix == ".rrd":
        return path.read_bytes()[:4]
    if path.suffix == ".md":
        assert path.read_text().endswith("\n")
        return None
    return path.read_bytes()


def results(folder: Path) -> dict:
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {str(path.relative_to(folder)): content(path) for path in paths}


def hidden(folder: Path) -> set[Path]:
    return set(folder.rglob(".*"))


def assert_part_of(part: dict, whole: dict) -> None:
    """Every result there is one of the uninterrupted run, or says itself how far it came."""
    for name, found in part.items():
        expected = whole[name]
        if name.endswith(".jsonl"):
            assert found == expected[: len(found)], name
        elif name == "report.json" and found.get("interrupted"):
            assert found["pairs"] == expected["pairs"][: len(found["pairs"])]
        else:
            assert found == expected, name


@pytest.fixture(scope="module", params=KILLS)
def uninterrupted(request, killable, room, tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "out"
    outcome = killable.run(*command(request.param, room, folder))
    assert outcome.code == 0, outcome.err
    assert not hidden(folder)
    return request.param, results(folder), folder


def test_killed_a_hundred_times_and_resumed(uninterrupted, killable, room, tmp_path):
    name, whole, _ = uninterrupted
    folder = tmp_path / "out"
    rng = np.random.default_rng(list(KILLS).index(name))
    stopped = 0
    for i in range(KILLS[name]):
        number = list(CODES)[i % 3]
        before = hidden(folder)
        outcome = killable.run(*command(name, room, folder), number=number, after=rng.uniform(0.0, 0.5))
        assert outcome.code in (CODES[number], 0), outcome.err
        assert_part_of(results(folder), whole)
        if number != signal.SIGKILL:
            assert "Traceback" not in outcome.err
            assert hidden(folder) <= before, "what was being written is taken away"
        if outcome.code == 0:
            shutil.rmtree(folder)
        else:
            stopped += 1
    assert stopped > KILLS[name] // 3, "they were to be caught in their middle"
    outcome = killable.run(*command(name, room, folder))
    assert outcome.code == 0, outcome.err
    assert results(folder) == whole


@pytest.mark.parametrize(
    ("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_command_that_is_stopped_says_so_in_one_line(killable, room, tmp_path, number, code, word):
    outcome = killable.run(*command("simulate", room, tmp_path / "out"), number=number, after=0.3)
    assert (outcome.code, outcome.err, outcome.out) == (code, f"adagmm-fusion: {word}\n", "")


@pytest.mark.parametrize(
    ("program", "arguments"), [("adagmm_fusion", ["run", "nowhere"]), ("adagmm_bench", ["methods"])]
)
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_stopped_while_it_is_still_importing(program, arguments, number, code):
    script = (
        "import sys\n"
        f"from {program}.cli import main\n"
        "assert 'open3d' not in sys.modules and 'cv2' not in sys.modules\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'open3d':\n"
        "            import os\n"
        f"            os.kill(os.getpid(), {int(number)})\n"
        "sys.meta_path.insert(0, Finder())\n"
        f"sys.exit(main({arguments!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr.count("\n") == 1 and done.stderr.startswith(program.replace("_", "-"))


# No room


@pytest.mark.parametrize(
    ("name", "file_bytes"), [(name, n) for name in (*KILLS, "convert") for n in (0, 1000)] + [("simulate", 0)]
)
def test_a_full_disk_is_one_line_and_nothing_torn(killable, room, tmp_path, name, file_bytes):
    folder = tmp_path / "out"
    outcome = killable.run(*command(name, room, folder), file_bytes=file_bytes)
    assert outcome.code == 1, outcome.err
    lines = [line for line in outcome.err.splitlines() if line.startswith("adagmm-")]
    assert len(lines) == 1 and "Traceback" not in outcome.err
    assert (str(folder) in lines[0] and "File too large" in lines[0]) or "Rerun recording: not all" in lines[0]
    results(folder)
    assert not hidden(tmp_path)


def test_a_full_disk_leaves_the_results_of_before(uninterrupted, killable, room, tmp_path):
    name, whole, finished = uninterrupted
    folder = tmp_path / "out"
    shutil.copytree(finished, folder)
    killable.run(*command(name, room, folder), file_bytes=100)
    after = results(folder)
    assert set(after) == set(whole)
    assert_part_of(after, whole)


def test_a_disk_that_fills_up_while_rerun_writes(killable, room, tmp_path):
    folder = tmp_path / "out"
    outcome = killable.run(*command("run", room, folder), "--no-clouds", file_bytes=1_100_000)
    assert outcome.code == 1, outcome.err
    assert "adagmm-fusion: Rerun recording: not all of it was written" in outcome.err
    assert set(results(folder)) == {"report.json", "report.md"} and not hidden(tmp_path)


@pytest.mark.parametrize("name", [*KILLS, "convert", "simulate"])
def test_an_output_that_cannot_be_written(killable, room, tmp_path, name):
    (tmp_path / "file").write_text("in the way")
    outcome = killable.run(*command(name, room, tmp_path / "file" / "out"))
    assert outcome.code == 1 and str(tmp_path / "file") in outcome.err
    assert outcome.err.count("\n") == 1 and outcome.err.startswith("adagmm-")


# Two at once


@pytest.mark.parametrize("name", ["run", "fuse"])
def test_two_runs_into_one_folder(killable, room, tmp_path, name):
    with exclusive(tmp_path / "out"):
        outcome = killable.run(*command(name, room, tmp_path / "out"))
    assert outcome.code == 1 and list((tmp_path / "out").iterdir()) == []
    assert outcome.err == (
        f"adagmm-fusion: {tmp_path / 'out'}: another run is writing here; give this one another --output\n"
    )
    with exclusive(tmp_path / "out"):  # free again
        pass


def test_two_benches_into_one_folder(killable, room, tmp_path):
    with Journal(tmp_path / "out" / "results.jsonl") as journal:
        journal.append({"key": "of the first"})
        outcome = killable.run(*command("bench", room, tmp_path / "out"), "--fresh")
        assert outcome.code == 1 and "another run is writing here" in outcome.err
    with Journal(tmp_path / "out" / "results.jsonl") as journal:
        assert list(journal.records) == ["of the first"]


def test_two_conversions_into_one_folder(room, tmp_path):
    recording = open_recording(room)
    refused = []

    def while_converting(done, _):
        if done == 3:
            with pytest.raises(OutputError, match="another run is writing here") as caught:
                convert_recording(recording, tmp_path / "copy")
            refused.append(caught.value)

    convert_recording(recording, tmp_path / "copy", on_frame=while_converting)
    assert len(refused) == 1
    assert len(open_recording(tmp_path / "copy").entries) == 5


def test_a_conversion_after_one_that_was_killed(killable, room, tmp_path):
    left = tmp_path / ".copy.partial" / "camera" / "depth"
    left.mkdir(parents=True)
    (left / "00003.png").write_bytes(b"half")
    (tmp_path / ".copy.partial" / "recording.yaml").write_text("half")
    convert_recording(open_recording(room), tmp_path / "copy")
    assert len(open_recording(tmp_path / "copy").entries) == 5 and not hidden(tmp_path)


@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)])
def test_a_signal_during_an_import_is_heard_after_it(number, expected, tmp_path, monkeypatch):
    name = f"signalled_{number}"
    (tmp_path / f"{name}.py").write_text(f"import signal\nsignal.raise_signal({int(number)})\ndone = True\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(expected), signals_as_interrupts():
        importlib.import_module(name)
        time.sleep(30.0)
    assert sys.modules.pop(name).done


@pytest.mark.parametrize(
    ("module", "function"),
    [
        ("llvmlite.binding.executionengine", "ExecutionEngine._raw_object_cache_getbuffer"),
        ("llvmlite.binding.executionengine", "ExecutionEngine._raw_object_cache_notify"),
        ("pyparsing.core", "Forward.__init__"),
        ("matplotlib.transforms", "Transform.__array__"),
    ],
)
def test_a_signal_is_not_raised_where_it_would_do_harm(module, function):
    *classes, name = function.split(".")
    place = importlib.import_module(module)
    for part in classes:
        place = getattr(place, part)
    assert name in vars(place), "it has another name now"
    names = {"signal": signal, "__name__": module}
    exec(f"def {name}():\n    signal.raise_signal(signal.SIGTERM)\n    return 'came to its end'", names)
    started = time.monotonic()
    with pytest.raises(Terminated), signals_as_interrupts():
        assert names[name]() == "came to its end"
        time.sleep(30.0)
    assert time.monotonic() - started < 20.0, "heard only after the sleep"


@pytest.mark.parametrize(("number", "expected"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)])
def test_a_signal_while_something_is_thrown_away_is_not_lost(number, expected):
    class Noisy:
        def __del__(self):
            signal.raise_signal(number)

    started = time.monotonic()
    with pytest.raises(expected), signals_as_interrupts():
        Noisy()
        time.sleep(30.0)
    assert time.monotonic() - started < 20.0, "heard only after the sleep"
