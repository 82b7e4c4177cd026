"""The command `adagmm-fusion`. Known errors end here: one line on stderr, exit code 1; so do Ctrl-C and SIGTERM.

A command's modules are imported when it is the one that runs: Open3D, Numba and Rerun take a second each.
"""

import argparse
import importlib
import sys
from collections.abc import Sequence

from adagmm_fusion.completion import add_completion
from adagmm_fusion.missing_library import explain
from adagmm_fusion.processes.interruption import exit_code, heard_afterwards, signals_as_interrupts, word_for
from adagmm_fusion.processes.terminal import printing, say

# The commands, and what the list of them says of each.
COMMANDS = {
    "run": "register the pairs of a recording",
    "simulate": "render a recording of two Kinects",
    "info": "say what is in a recording",
    "convert": "write a recording in our own layout",
    "calibrate": "make a rig file from images of a board, or of any scene",
    "convert-rig": "make a rig file of other programs' calibrations",
    "verify": "say whether a rig's calibration is still true",
    "fuse": "fuse a whole recording into one mesh",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    try:
        with signals_as_interrupts():
            return printing("adagmm-fusion", lambda: _run_command(arguments))
    except KeyboardInterrupt as stop:
        say(f"adagmm-fusion: {word_for(stop)}")
        return exit_code(stop)


def _run_command(arguments: Sequence[str] | None) -> int:
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    name = next((argument for argument in arguments if argument in COMMANDS), None)
    try:
        if name is None:
            parser([]).parse_args(arguments)  # prints what is asked for, or what is wrong, and exits
        with heard_afterwards():
            from adagmm_fusion.errors import AdaGMMError, one_line
        try:
            with heard_afterwards():
                command_line = parser([name])
            if name == "run":
                from adagmm_fusion.commands.run_config import with_config
                from adagmm_fusion.commands.run_options import SETTINGS_OPTIONS

                arguments = with_config(arguments, SETTINGS_OPTIONS)
            args = command_line.parse_args(arguments)
            return args.run(args)
        except AdaGMMError as problem:
            say(f"adagmm-fusion: {one_line(problem)}")
            return 1
    except (ImportError, OSError) as problem:
        if (line := explain(problem)) is None:
            raise
        say(f"adagmm-fusion: {line}")
        return 1


def parser(filled_in: Sequence[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The command line's grammar; commands other than those named are in it without their options."""
    top = argparse.ArgumentParser(prog="adagmm-fusion", description="Register and fuse recorded RGB-D pairs.")
    top.add_argument("--version", action=_PrintVersion, nargs=0, help="show program's version number and exit")
    add_completion(top, parser)
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for name, summary in COMMANDS.items():
        if name not in filled_in:
            commands.add_parser(name, help=summary)
        else:
            module = "run_options" if name == "run" else name.replace("-", "_")
            importlib.import_module(f"adagmm_fusion.commands.{module}").add(commands)
    return top


class _PrintVersion(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib import metadata

        print(f"{parser.prog} {metadata.version('adagmm-o3d')}")
        parser.exit()
