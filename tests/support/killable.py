"""A process that has imported all but Rerun and runs commands in forks of itself, which can be killed soon and often.

It keeps to one core and one thread: a fork has no other threads, and must not wait for any. A command that does not
end is stopped, and what its threads were at is in what it printed.
"""

import faulthandler
import fcntl
import importlib
import json
import os
import resource
import subprocess
import sys
import time
import traceback
from dataclasses import dataclass
from pathlib import Path

SERVER = """
import os
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
import sys
sys.path.insert(0, %r)
import killable
killable.serve()
"""
# Rerun and what it imports have threads from the start, so each fork imports it for itself.
OF_RERUN = "adagmm_fusion.commands.run"
LONGEST_S = 300.0
ONE_THREAD = {name: "1" for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


@dataclass(frozen=True)
class Outcome:
    """How a command ended: its exit code (minus the signal that killed it), and what it printed."""

    code: int
    out: str
    err: str


class Killable:
    """Runs `adagmm-fusion` or `adagmm-bench` and sends it a signal after some time."""

    def __init__(self) -> None:
        self._server = subprocess.Popen(
            [sys.executable, "-c", SERVER % str(Path(__file__).parent)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | ONE_THREAD,
        )

    def run(self, *command, number: int = 0, after: float = 0.0, file_bytes: int | None = None) -> Outcome:
        """number : of the signal, 0 for none.    file_bytes : no file can become larger, as if the disk were full."""
        request = {"command": list(map(str, command)), "number": number, "after": after, "file_bytes": file_bytes}
        print(json.dumps(request), file=self._server.stdin, flush=True)
        return Outcome(**json.loads(self._server.stdout.readline()))

    def close(self) -> None:
        self._server.stdin.close()
        self._server.wait(timeout=60)


def serve() -> None:
    import cv2
    import matplotlib.pyplot  # noqa: F401  what a command imports late

    import adagmm_bench.cli
    import adagmm_bench.runner
    import adagmm_fusion.cli
    from adagmm_fusion.pairs.pipeline import compile_kernels

    def one_by_one(function, tasks, **_):
        return ((key, function(task)) for key, task in tasks.items())

    cv2.setNumThreads(0)
    adagmm_bench.cli.build_parser(("sim2d",))
    compile_kernels("cpu")
    adagmm_bench.runner.run_tasks = one_by_one  # no further processes
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    programs = {"adagmm-fusion": adagmm_fusion.cli, "adagmm-bench": adagmm_bench.cli}
    threads = [Path(f"/proc/self/task/{task}/comm").read_text() for task in os.listdir("/proc/self/task")]
    assert len(threads) == 1, threads
    for line in sys.stdin:
        print(json.dumps(_forked(programs, **json.loads(line))), file=answers, flush=True)


def _forked(programs, command: list[str], number: int, after: float, file_bytes: int | None) -> dict:
    out, err = _Printed(), _Printed()
    ready, hearing = os.pipe()
    pid = os.fork()
    if pid == 0:
        code = 70
        try:
            os.dup2(out.end, 1)
            os.dup2(err.end, 2)
            faulthandler.dump_traceback_later(LONGEST_S, exit=True, file=2)
            if command[0] == "adagmm-fusion":
                importlib.import_module(OF_RERUN)
            code = _code_of(programs[command[0]], command[1:], hearing, file_bytes)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:  # even if a signal comes after the command's end
            os._exit(code)
    os.close(hearing)
    os.read(ready, 1)
    os.close(ready)
    if number:
        time.sleep(after)
        os.kill(pid, number)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return {"code": code, "out": out.read(), "err": err.read()}


class _Printed:
    """A pipe that holds what a command prints, which a full disk does not stop."""

    def __init__(self) -> None:
        self._start, self.end = os.pipe()
        fcntl.fcntl(self.end, fcntl.F_SETPIPE_SZ, 1 << 20)

    def read(self) -> str:
        """What is there now: a process that the command left behind may hold the other end open."""
        os.close(self.end)
        os.set_blocking(self._start, False)
        with os.fdopen(self._start, "rb") as file:
            return (file.read() or b"").decode()


def _code_of(program, arguments: list[str], hearing: int, file_bytes: int | None) -> int:
    run_command = program._run_command

    def run(given):
        if file_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, resource.RLIM_INFINITY))
        os.close(hearing)  # from here on the command hears signals
        return run_command(given)

    program._run_command = run
    try:
        return program.main(arguments)
    except SystemExit as leaving:
        return leaving.code
    except BaseException:
        traceback.print_exc()
        return 70
