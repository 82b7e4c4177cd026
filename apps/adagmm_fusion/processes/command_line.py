"""How a program of several commands begins and ends: one command's modules, exit codes, errors and signals in one line.

A command's modules are imported when it is the one that runs: Open3D, Numba and Rerun take a second each.
"""

import argparse
import sys
from collections.abc import Callable, Collection, Sequence

from adagmm_fusion.missing_library import explain
from adagmm_fusion.processes.interruption import exit_code, heard_afterwards, signals_as_interrupts, word_for
from adagmm_fusion.processes.terminal import printing, say


def run_program(program: str, command: Callable[[], int], word: Callable[[KeyboardInterrupt], str] = word_for) -> int:
    """The exit code of `command`: what it returns, 130 after Ctrl-C, 143 after SIGTERM, 129 after SIGHUP.

    word : what is said of having been stopped.
    """
    try:
        with signals_as_interrupts():
            return printing(program, command)
    except KeyboardInterrupt as stop:
        say(f"{program}: {word(stop)}")
        return exit_code(stop)


def run_command(
    program: str,
    commands: Collection[str],
    build_parser: Callable[[Sequence[str]], argparse.ArgumentParser],
    arguments: Sequence[str] | None,
    *,
    own_extra: str = "apps",
    amend: Callable[[str, list[str]], list[str]] = lambda name, arguments: arguments,
) -> int:
    """Run the one of `commands` that `arguments` name, by default the process's; 1 after an error made on purpose.

    build_parser : the grammar, with the options of the commands it is given; each sets `run`.
    own_extra : see `explain`.   amend : what is to be parsed, made of a command's name and the arguments.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    name = next((argument for argument in arguments if argument in commands), None)
    try:
        if name is None:
            # It prints what is asked for, or what is wrong, and exits.
            build_parser([]).parse_args(arguments)
            raise AssertionError("a command line without a command was parsed")
        with heard_afterwards():
            from adagmm_fusion.errors import AdaGMMError, one_line
        try:
            with heard_afterwards():
                command_line = build_parser([name])
            parsed = command_line.parse_args(amend(name, arguments))
            return parsed.run(parsed)
        except AdaGMMError as error:
            say(f"{program}: {one_line(error)}")
            return 1
    except (ImportError, OSError) as error:
        if (line := explain(error, own_extra)) is None:
            raise
        say(f"{program}: {line}")
        return 1
