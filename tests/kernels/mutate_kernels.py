"""Is every formula of the kernels held by some test? Each is made wrong on purpose, one place at a time.

    python tests/kernels/mutate_kernels.py [cpu] [cuda] [FILE...]      all, or some; e.g. formulas.py cpu/nearest.py

A mutant is a copy of the package in which one text of one kernel is another: a sign, a factor, an index. The tests of
that kernel must fail on it. CPU kernels run uncompiled, CUDA kernels in the simulator. Says which test found each
mutant, and ends with 1 if one was not found. The mutants are listed in kernel_mutants.py.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
MODES = {"cpu": {"NUMBA_DISABLE_JIT": "1"}, "cuda": {"NUMBA_ENABLE_CUDASIM": "1"}}
PATIENCE_S = 900


def main(arguments: list[str]) -> int:
    """Run every mode in a process of its own, which has to be told before Numba is imported."""
    if os.environ.get("MUTATING") in MODES:
        return mutate(os.environ["MUTATING"], arguments)
    modes = [a for a in arguments if a in MODES] or list(MODES)
    files = [a for a in arguments if a not in MODES]
    codes = [
        subprocess.run(
            [sys.executable, __file__, *files], env=os.environ | MODES[m] | {"MUTATING": m}, cwd=ROOT
        ).returncode
        for m in modes
    ]
    return max(codes)


def mutate(mode: str, files: list[str]) -> int:
    """Try the mutants of one mode; every one in a fork of this process, in which the libraries are loaded already."""
    import hypothesis  # noqa: F401
    import numba.cuda
    import numba.extending  # noqa: F401
    import open3d  # noqa: F401
    import pytest  # noqa: F401
    import scipy.optimize
    import scipy.stats  # noqa: F401
    from kernel_mutants import MUTANTS, TESTS_OF

    survivors = 0
    chosen = {file: mutants for file, mutants in MUTANTS[mode].items() if not files or file in files}
    todo = [(file, *m) for file, mutants in chosen.items() for m in [("", ""), *mutants]]
    for file, *place, text, replacement in todo:
        with tempfile.TemporaryDirectory() as folder:
            package = Path(folder) / "adagmm_o3d"
            shutil.copytree(ROOT / "adagmm_o3d", package, ignore=shutil.ignore_patterns("__pycache__"))
            if text:
                replace_once(package / "kernels" / file, text, replacement, *place)
            killer = first_failure(Path(folder), TESTS_OF[mode][file])
        if not text:
            # Where a test fails anyway, it tells nothing of a mutant.
            if killer:
                raise SystemExit(f"{mode}: {killer} fails without any mutant of {file}")
            continue
        survivors += not killer
        where = ".".join([file, *place])
        print(f"{where}: {shown(text)} -> {shown(replacement)}: {killer or 'SURVIVED'}", flush=True)
    print(f"{mode}: {len(todo) - len(chosen)} mutants, {survivors} survived", flush=True)
    return int(survivors > 0)


def replace_once(path: Path, text: str, replacement: str, function: str = "") -> None:
    """Fails loudly where the kernel has changed and the mutant is none any more."""
    before, after, source = "", "", path.read_text()
    if function:
        before, start, source = source.partition(f"\ndef {function}(")
        body, end, after = source.partition("\n\n\n")
        before, source, after = before + start, body, end + after
    if source.count(text) != 1:
        raise SystemExit(
            f"{path.name} {function}: {text!r} is there {source.count(text)} times, not once; bring the list up to date"
        )
    path.write_text(before + source.replace(text, replacement) + after)


def first_failure(folder: Path, tests: list[str]) -> str:
    """Run tests with the package in `folder`, until one fails: its name, or nothing."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.close(reading)
            signal.alarm(PATIENCE_S)
            name = _in_child(folder, tests)
            os.write(writing, name.encode())
            code = 0
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        name = pipe.read()
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return name if code == 0 else f"(the process ended with {code})"


def _in_child(folder: Path, tests: list[str]) -> str:
    import pytest

    class Recorder:
        failed = ""

        def pytest_runtest_logreport(self, report):
            if report.failed and not self.failed:
                self.failed = report.nodeid.split("/")[-1]

        def pytest_collectreport(self, report):
            if report.failed and not self.failed:
                self.failed = f"(import of {report.nodeid})"

    sys.path.insert(0, str(folder))
    recorder = Recorder()
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    pytest.main(["-x", "-q", "-p", "no:cacheprovider", "--rootdir", str(ROOT), *tests], plugins=[recorder])
    import adagmm_o3d

    assert Path(adagmm_o3d.__file__).is_relative_to(folder)
    return recorder.failed


def shown(text: str) -> str:
    return " ".join(text.split())


if __name__ == "__main__":
    sys.path.insert(0, str(HERE))
    sys.exit(main(sys.argv[1:]))
