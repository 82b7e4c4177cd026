"""The command `adagmm-fusion`. Known errors end here: one line on stderr, exit code 1; so do Ctrl-C and SIGTERM."""

import argparse
import importlib
from collections.abc import Sequence

from adagmm_fusion.completion import add_completion
from adagmm_fusion.processes.command_line import run_command, run_program

PROGRAM = "adagmm-fusion"
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
    return run_program(PROGRAM, lambda: _run_command(arguments))


def _run_command(arguments: Sequence[str] | None) -> int:
    return run_command(PROGRAM, COMMANDS, parser, arguments, amend=_with_config)


def _with_config(name: str, arguments: list[str]) -> list[str]:
    """The arguments, those of `run` with the settings of its --config file."""
    if name != "run":
        return arguments
    from adagmm_fusion.commands.run_config import with_config
    from adagmm_fusion.commands.run_options import SETTINGS_OPTIONS

    return with_config(arguments, SETTINGS_OPTIONS)


def parser(filled_in: Sequence[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The command line's grammar; commands other than those named are in it without their options."""
    top = argparse.ArgumentParser(prog=PROGRAM, description="Register and fuse recorded RGB-D pairs.")
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
