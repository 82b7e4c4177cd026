"""The command `adagmm-bench`. Errors made on purpose end in one line on stderr and exit code 1."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial

from adagmm_fusion.processes.interruption import exit_code, heard_afterwards, signals_as_interrupts
from adagmm_fusion.processes.terminal import printing, say


def build_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="adagmm-bench", description="The paper's experiments, with other registration methods beside ours."
    )
    from adagmm_bench.commands import (
        ablation,
        covariance,
        gpu,
        kinect,
        methods_list,
        pairs,
        recordings,
        replay,
        simulations,
        speed,
    )

    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def add(name: str, summary: str, add_arguments: Callable, run: Callable) -> None:
        command = commands.add_parser(name, help=summary, description=summary)
        add_arguments(command)
        command.set_defaults(run=run)

    for dimension in (2, 3):
        add(
            f"sim{dimension}d",
            f"the four sweeps of Section 4.1 in {dimension}D",
            partial(simulations.add_arguments, dimension=dimension),
            partial(simulations.run, dimension=dimension),
        )
    add("kinect", "the paper's Kinect scenes and its Figure 18", kinect.add_arguments, kinect.run)
    add(
        "recordings",
        "RGB-D recordings with ground truth, end to end through the app",
        recordings.add_arguments,
        recordings.run,
    )
    add(
        "pairs",
        "clouds as people bring them: found, and known to be wrong, beside others",
        pairs.add_arguments,
        pairs.run,
    )
    add("speed", "how fast, beside other libraries, and against recorded ratios", speed.add_arguments, speed.run)
    add(
        "ablation",
        "what each choice of the default is worth: one undone at a time",
        ablation.add_arguments,
        ablation.run,
    )
    add(
        "covariance",
        "whether true errors are as large as the pose covariance says",
        covariance.add_arguments,
        covariance.run,
    )
    add("gpu", "the CUDA kernels on this machine's card: right, and how fast", gpu.add_arguments, gpu.run)
    add("replay", "one trial again, alone, printed and shown in Rerun", replay.add_arguments, replay.run)
    add("methods", "the methods, their settings, and which can run here", methods_list.add_arguments, methods_list.run)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; 0 when it did what it was asked to, 1 on an error or a regression, 2 on wrong usage; 130 after
    Ctrl-C, 143 after SIGTERM.
    """
    try:
        with signals_as_interrupts():
            return printing("adagmm-bench", lambda: _run_command(arguments))
    except KeyboardInterrupt as stop:
        say("adagmm-bench: stopped; the same command goes on from here")
        return exit_code(stop)


def _run_command(arguments: Sequence[str] | None) -> int:
    with heard_afterwards():
        from adagmm_fusion.errors import AdaGMMError, one_line

        command_line = build_parser()
    parsed = command_line.parse_args(arguments)
    try:
        return parsed.run(parsed)
    except AdaGMMError as error:
        say(f"adagmm-bench: {one_line(error)}")
        return 1
