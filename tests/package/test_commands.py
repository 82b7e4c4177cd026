"""The two commands: what they import before they run, and what they say where libraries are missing."""

import argparse
import subprocess
import sys

import pytest
import rerun
from shared_data import ROOT

import adagmm_bench.cli
import adagmm_fusion.cli
import adagmm_fusion.commands.simulate
from adagmm_fusion.rerun_arguments import add_rerun_arguments

SHIPPED = str(ROOT / "recordings" / "two_kinects")
HEAVY = {"numpy", "open3d", "numba", "rerun", "cv2", "scipy", "matplotlib", "rich", "yaml"}
IMPORTED = """
import sys
from {program}.cli import main
try:
    main({arguments!r})
except SystemExit:
    pass
print("imported:", *sorted({heavy!r} & set(sys.modules)))
"""
BLOCKED = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {missing!r}:
            raise {error}

sys.meta_path.insert(0, Blocked())
from {program}.cli import main
sys.exit(main({arguments!r}))
"""
NOT_FOUND = "ModuleNotFoundError(f'No module named {name!r}', name=name)"
NO_EGL = "ImportError('libEGL.so.1: cannot open shared object file: No such file or directory', name=name)"


def python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


@pytest.mark.parametrize(
    ("program", "arguments", "allowed"),
    [
        ("adagmm_fusion", ["--version"], set()),
        ("adagmm_fusion", ["--help"], set()),
        ("adagmm_fusion", [], set()),
        ("adagmm_fusion", ["run", "--help"], {"numpy"}),
        ("adagmm_fusion", ["fuse", "--help"], {"numpy"}),
        ("adagmm_bench", ["--help"], set()),
    ],
)
def test_help_imports_nothing_that_takes_long(program, arguments, allowed):
    done = python(IMPORTED.format(program=program, arguments=arguments, heavy=HEAVY))
    assert done.returncode == 0, done.stderr
    imported = set(done.stdout.splitlines()[-1].split()[1:])
    assert imported <= allowed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "arguments", "missing", "message"),
    [
        ("adagmm_fusion", ["info", SHIPPED], {"cv2"}, "cv2 is needed and not installed; pip install "),
        ("adagmm_fusion", ["run", SHIPPED], {"rerun"}, "'adagmm-o3d[apps]'"),
        ("adagmm_fusion", ["run", SHIPPED], {"yaml", "rich", "scipy"}, "'adagmm-o3d[apps]'"),
        ("adagmm_fusion", ["run", SHIPPED], {"open3d"}, "'adagmm-o3d[open3d]'"),
        ("adagmm_fusion", ["simulate", "somewhere"], {"cv2"}, "'adagmm-o3d[apps]'"),
        ("adagmm_bench", ["sim2d"], {"matplotlib"}, "'adagmm-o3d[bench]'"),
        ("adagmm_bench", ["methods"], {"open3d"}, "'adagmm-o3d[open3d]'"),
    ],
)
def test_a_missing_library_is_one_line_that_names_its_extra(program, arguments, missing, message):
    done = python(BLOCKED.format(program=program, arguments=arguments, missing=missing, error=NOT_FOUND))
    assert done.returncode == 1 and done.stdout == "", done.stderr
    assert done.stderr.count("\n") == 1 and message in done.stderr
    assert done.stderr.startswith(program.replace("_", "-") + ": ")


def test_a_missing_library_of_the_system_is_one_line_that_names_packages():
    arguments = ["run", SHIPPED]
    done = python(BLOCKED.format(program="adagmm_fusion", arguments=arguments, missing={"open3d"}, error=NO_EGL))
    assert done.returncode == 1 and done.stderr.count("\n") == 1, done.stderr
    assert "libEGL.so.1" in done.stderr and "apt-get install" in done.stderr and "libegl1" in done.stderr


def test_a_fault_of_our_own_is_not_taken_for_a_missing_library(monkeypatch):
    def broken(_):
        raise ImportError("cannot import name 'x' from 'adagmm_fusion'")

    monkeypatch.setattr(adagmm_fusion.commands.simulate, "run", broken)
    with pytest.raises(ImportError, match="cannot import name"):
        adagmm_fusion.cli.main(["simulate", "somewhere"])


@pytest.mark.parametrize(
    ("whole", "commands"),
    [
        (adagmm_fusion.cli.parser, adagmm_fusion.cli.COMMANDS),
        (adagmm_bench.cli.build_parser, {name: summary for name, (_, _, summary) in adagmm_bench.cli.COMMANDS.items()}),
    ],
)
def test_the_list_of_commands_says_what_each_says_of_itself(whole, commands):
    for parser in (whole([]), whole()):
        listed = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        assert {choice.dest: choice.help for choice in listed._choices_actions} == commands
        assert set(listed.choices) == set(commands)


def test_reruns_own_arguments_are_all_there():
    def said(add):
        parser = argparse.ArgumentParser()
        add(parser)
        return {a.dest: (a.option_strings, a.nargs, a.type, a.default, a.help) for a in parser._actions}

    ours, theirs = said(add_rerun_arguments), said(rerun.script_add_args)
    assert {name: ours[name] for name in theirs} == theirs
    assert set(ours) - set(theirs) == {"port"}


@pytest.mark.slow
@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
@pytest.mark.parametrize(("program", "option"), [("adagmm_fusion", "max-rotation-error"), ("adagmm_bench", "workers")])
def test_a_shell_completes_the_options_of_every_command(program, option, shell):
    pytest.importorskip("shtab", reason="needs shtab, which the extra apps brings")
    done = subprocess.run(
        [sys.executable, "-m", program, "--print-completion", shell], capture_output=True, text=True, check=True
    )
    assert option in done.stdout
