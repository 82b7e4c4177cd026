"""What is printed: in any encoding, on a full disk, for a reader who has gone, after a hang-up; names are data."""

import io
import json
import os
import pty
import shutil
import signal
import subprocess
import sys
import time

import pytest
from shared_data import ROOT
from tiny_recording import small_sensor

import adagmm_bench.cli
import adagmm_fusion.commands.run
from adagmm_bench.report import print_table
from adagmm_fusion.cli import main
from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.pairs.report import COLUMNS
from adagmm_fusion.processes.interruption import HungUp, exit_code, signals_as_interrupts
from adagmm_fusion.processes.terminal import printable, printing
from adagmm_fusion.simulation.recording import simulate_recording

SHIPPED = str(ROOT / "recordings" / "two_kinects")
ENCODINGS = ("ascii", "latin-1", "cp1252", "cp437", "cp932", "utf-8")
QUICK = ["--no-rerun", "--no-clouds", "--target-points", "500", "--device", "cpu"]


@pytest.fixture
def room(tmp_path, monkeypatch):
    """A small recording in a folder whose name is markup and is in no old encoding."""
    small_sensor(monkeypatch)
    folder = tmp_path / "[red]räume→部屋[/]"
    simulate_recording(folder, pairs=1, seed=5)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_any_encoding_will_do(encoding, room, tmp_path, monkeypatch):
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="strict") for _ in range(2))
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    assert main(["run", str(room), "--output", str(tmp_path / "out ± "), *QUICK]) == 0
    assert main(["info", str(room)]) == 0
    assert main(["info", str(tmp_path / "nowhere °")]) == 1
    assert (out.errors, err.errors) == ("strict", "strict"), "as they were"
    for stream in (out, err):
        stream.flush()
    printed, complained = (stream.buffer.getvalue().decode(encoding) for stream in (out, err))
    for words in ("[red]r", "[/]", "translation [mm]", "rotation [", "report: "):
        assert words in printed
    if encoding in ("ascii", "cp1252"):
        assert "\\u90e8\\u5c4b" in printed and ("rotation [deg]" in printed) == (encoding == "ascii")
    if encoding == "utf-8":
        assert all(column in printed for column in COLUMNS) and room.name in printed
    assert complained.count("\n") == 1 and "nowhere " in complained


def test_what_is_printed_is_plain_where_it_has_to_be():
    out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    before, sys.stdout = sys.stdout, out
    try:
        printing("program", lambda: print("0.5° ± 0.1, σ ≤ 2 × 3 −1 → „\udcff” " + " ".join(COLUMNS)) or 0)
    finally:
        sys.stdout = before
    text = out.buffer.getvalue().decode()
    assert text.startswith("0.5deg +- 0.1, sigma <= 2 x 3 -1 -> \\u201e\\udcff\\u201d ")
    assert "\\" not in text.split("\\u201d ")[1], "our own columns need no escapes"


@pytest.mark.parametrize("name", ["\x1b[31mred", "a\nb", "a\rb", "\x9b2J", "\u202eabc", "\udcff"])
def test_names_are_printed_as_data(name, tmp_path, capsys):
    assert printable(name).isprintable() and printable("[bold]ü") == "[bold]ü"
    print_table(f"[bold]{name}", [f"[red]{name}"], [[f"[link]{name}"]])
    out = capsys.readouterr().out
    assert all(character.isprintable() or character == "\n" for character in out), out
    for words in ("[bold]", "[red]", "[link]"):
        assert words in out


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="file names of bytes")
def test_a_folder_with_escapes(room, tmp_path, capsys):
    output = tmp_path / "\x1b[31m[red]out"
    assert main(["run", str(room), "--output", str(output), *QUICK]) == 0
    assert main(["convert", str(room), str(tmp_path / "\x1b[31mcopy")]) == 0
    assert main(["simulate", str(tmp_path / "\x1b[31mroom"), "--pairs", "1"]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out and out.count("\\x1b[31m") > 4 and "\\x1b[31m[red]out/report.json" in out


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="file names of bytes")
def test_a_folder_whose_name_is_no_text(room, tmp_path, capsys):
    output = os.fsdecode(os.fsencode(tmp_path) + b"/out\xff")
    assert main(["run", str(room), "--output", output, *QUICK]) == 0
    report = json.loads((tmp_path / output / "report.json").read_text(encoding="utf-8"))
    assert report["summary"]["pairs_done"] == 1
    capsys.readouterr()
    assert main(["run", str(room), "--output", output, *QUICK[1:]]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "expected a name in UTF-8 for a Rerun recording" in err and "\\udcff" in err
    write_text(tmp_path / "report.md", "of out\udcff")
    assert (tmp_path / "report.md").read_text(encoding="utf-8") == "of out\\udcff"


@pytest.mark.slow
def test_many_recordings_with_markup_in_their_names(room, tmp_path, capsys):
    folder = tmp_path / "many"
    folder.mkdir()
    shutil.move(room, folder / "[red]a")
    (folder / "[b]").mkdir()
    (folder / "[b]" / "recording.yaml").write_text("nonsense")
    assert main(["run", str(folder), "--output", str(tmp_path / "out"), "--workers", "1", *QUICK]) == 1
    out = capsys.readouterr().out
    assert "[red]a" in out and "[b]" in out and "[mm]" in out and "[°]" in out


# No room, no reader, no terminal


class Full(io.TextIOBase):
    """What takes nothing."""

    encoding = "utf-8"

    def __init__(self, number):
        self.number = number

    def write(self, text):
        raise OSError(self.number, os.strerror(self.number))

    def flush(self):
        return None


@pytest.mark.parametrize(
    ("number", "lines"), [(28, 1), (5, 1), (27, 1), (32, 0)], ids=["full", "gone", "large", "pipe"]
)
def test_output_that_is_not_taken(number, lines, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdout", Full(number))
    for program, command in ((main, ["info", SHIPPED]), (adagmm_bench.cli.main, ["methods"])):
        if lines == 0 and program is main:
            continue  # rich ends the process by itself
        assert program(command) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == lines
        if lines:
            assert err.endswith(f": the output cannot be printed: {os.strerror(number)}\n")


@pytest.mark.parametrize(
    ("problem", "line"),
    [
        (MemoryError(), "the memory is not enough (no more is given); take less data at a time"),
        (MemoryError("Unable to allocate 9 GiB"), "the memory is not enough (Unable to allocate 9 GiB); take less"),
        (OSError(24, "Too many open files", "a.txt"), "too many files are open; allow more, as with ulimit -n 1024"),
    ],
)
def test_a_machine_that_gives_no_more(problem, line, capsys):
    def work():
        raise problem

    assert printing("program", work) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith(f"program: {line}") and err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stdout", "stderr", "both"])
def test_a_process_without_output(name, monkeypatch):
    for stream in ("stdout", "stderr") if name == "both" else (name,):
        monkeypatch.setattr(sys, stream, None)
    assert main(["info", SHIPPED]) == 0
    assert main(["info", "nowhere"]) == 1
    assert name == "stderr" or sys.stdout is None


def test_errors_that_are_no_output_are_not_hidden(tmp_path, monkeypatch):
    def broken():
        raise OSError(28, "No space left on device", "some file")

    def stopped_and_full():
        try:
            raise KeyboardInterrupt
        finally:
            raise OSError(5, "Input/output error")

    # What could not be printed is thrown away with the file behind stdout, and pytest reads its own again.
    with open(tmp_path / "printed", "w", encoding="utf-8") as printed:
        monkeypatch.setattr(sys, "stdout", printed)
        with pytest.raises(OSError, match="some file"):
            printing("program", broken)
        with pytest.raises(KeyboardInterrupt):
            printing("program", stopped_and_full)
        with pytest.raises(OutputError):
            printing("program", lambda: write_text("", ""))
        monkeypatch.undo()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full")
@pytest.mark.parametrize("command", [["info", SHIPPED], ["run", SHIPPED, "--pairs", "0", *QUICK]])
def test_a_full_disk_behind_the_output(command, tmp_path):
    more = ["--output", str(tmp_path / "out")] if command[0] == "run" else []
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "adagmm_fusion", *command, *more],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            timeout=300,
            check=False,
        )
    lines = [line for line in done.stderr.splitlines() if not line.startswith("compiling kernels")]
    assert done.returncode == 1
    assert lines == ["adagmm-fusion: the output cannot be printed: No space left on device"]
    if more:
        assert json.loads((tmp_path / "out" / "report.json").read_text())["summary"]["pairs_done"] == 1


@pytest.fixture
def not_under_nohup():
    """Hanging up does what it does in a terminal, whoever runs the tests."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="POSIX")
@pytest.mark.usefixtures("not_under_nohup")
def test_a_terminal_that_goes_away(room, tmp_path, monkeypatch):
    """Neither the terminal nor its owner is there any more: what was finished is reported, and nothing else fails."""
    ours, theirs = pty.openpty()
    run_pairs = adagmm_fusion.commands.run.run_pairs

    def hung_up_after_one(*arguments):
        yield next(run_pairs(*arguments))
        os.close(ours)
        signal.raise_signal(signal.SIGHUP)
        time.sleep(30.0)

    monkeypatch.setattr(adagmm_fusion.commands.run, "run_pairs", hung_up_after_one)
    with os.fdopen(theirs, "w") as terminal, monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", terminal)
        patched.setattr(sys, "stderr", terminal)
        assert main(["run", str(room), "--output", str(tmp_path / "out"), *QUICK]) == 129
        # What is left in its buffer has nowhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), terminal.fileno())
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["interrupted"] and report["summary"]["pairs_done"] == 1


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="POSIX")
@pytest.mark.usefixtures("not_under_nohup")
def test_hanging_up_is_heard_and_under_nohup_is_not():
    with pytest.raises(HungUp) as caught, signals_as_interrupts():
        signal.raise_signal(signal.SIGHUP)
        time.sleep(30.0)
    assert exit_code(caught.value) == 129
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with signals_as_interrupts():
            signal.raise_signal(signal.SIGHUP)
            time.sleep(0.1)
    finally:
        assert signal.signal(signal.SIGHUP, before) == signal.SIG_IGN
