"""The command `adagmm-bench`. Errors made on purpose end in one line on stderr and exit code 1."""

from __future__ import annotations

import argparse
import importlib
from collections.abc import Sequence
from functools import partial

from adagmm_fusion.completion import add_completion
from adagmm_fusion.processes.command_line import run_command, run_program

PROGRAM = "adagmm-bench"
# The commands: the module of each, what its functions are told, and what the list of commands says of it.
COMMANDS = {
    "sim2d": ("simulations", {"dimension": 2}, "the four sweeps of Section 4.1 in 2D"),
    "sim3d": ("simulations", {"dimension": 3}, "the four sweeps of Section 4.1 in 3D"),
    "kinect": ("kinect", {}, "the paper's Kinect scenes and its Figure 18"),
    "recordings": ("recordings", {}, "RGB-D recordings with ground truth, end to end through the app"),
    "pairs": ("pairs", {}, "clouds as people bring them: found, and known to be wrong, beside others"),
    "belief": ("belief", {}, "the regression behind details.belief, fitted to the outcomes of pairs"),
    "speed": ("speed", {}, "how fast, beside other libraries, and against recorded ratios"),
    "ablation": ("ablation", {}, "what each choice of the default is worth: one undone at a time"),
    "color": ("color", {}, "what colours are worth, beside Open3D's coloured ICP from the same starts"),
    "covariance": ("covariance", {}, "whether true errors are as large as the pose covariance says"),
    "gpu": ("gpu", {}, "the CUDA kernels on this machine's card: right, and how fast"),
    "replay": ("replay", {}, "one trial again, alone, printed and shown in Rerun"),
    "methods": ("methods_list", {}, "the methods, their settings, and which can run here"),
}


def build_parser(filled_in: Sequence[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The command line's grammar; commands other than those named are in it without their options, unimported."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM, description="The paper's experiments, with other registration methods beside ours."
    )
    add_completion(parser, build_parser)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, (module_name, told, summary) in COMMANDS.items():
        command = commands.add_parser(name, help=summary, description=summary)
        if name in filled_in:
            module = importlib.import_module(f"adagmm_bench.commands.{module_name}")
            module.add_arguments(command, **told)
            command.set_defaults(run=partial(module.run, **told))
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 when it did what it was asked to, 1 on an error or a regression, 2 on wrong usage; 130 after
    Ctrl-C, 143 after SIGTERM.
    """
    return run_program(
        PROGRAM, lambda: _run_command(arguments), lambda _: "stopped; the same command goes on from here"
    )


def _run_command(arguments: Sequence[str] | None) -> int:
    return run_command(PROGRAM, COMMANDS, build_parser, arguments, own_extra="bench")
