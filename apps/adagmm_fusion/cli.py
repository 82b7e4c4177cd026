"""The command `adagmm-fusion`. Known errors end here: one line on stderr, exit code 1; so do Ctrl-C and SIGTERM.

Little is imported before signals are heard: Open3D and Numba take a second.
"""

import argparse
from collections.abc import Sequence
from importlib import metadata

from adagmm_fusion.processes.interruption import exit_code, heard_afterwards, signals_as_interrupts, word_for
from adagmm_fusion.processes.terminal import printing, say


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    try:
        with signals_as_interrupts():
            return printing("adagmm-fusion", lambda: _run_command(arguments))
    except KeyboardInterrupt as stop:
        say(f"adagmm-fusion: {word_for(stop)}")
        return exit_code(stop)


def _run_command(arguments: Sequence[str] | None) -> int:
    with heard_afterwards():
        from adagmm_fusion.errors import AdaGMMError, one_line

        command_line = parser()
    args = command_line.parse_args(arguments)
    try:
        return args.run(args)
    except AdaGMMError as problem:
        say(f"adagmm-fusion: {one_line(problem)}")
        return 1


def parser() -> argparse.ArgumentParser:
    """The command line's grammar."""
    from adagmm_fusion.commands import calibrate, convert, convert_rig, fuse, info, run_options, simulate, verify

    top = argparse.ArgumentParser(prog="adagmm-fusion", description="Register and fuse recorded RGB-D pairs.")
    top.add_argument("--version", action="version", version=f"%(prog)s {metadata.version('adagmm-o3d')}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    run_options.add(commands)
    simulate.add(commands)
    info.add(commands)
    convert.add(commands)
    calibrate.add(commands)
    convert_rig.add(commands)
    verify.add(commands)
    fuse.add(commands)
    return top
