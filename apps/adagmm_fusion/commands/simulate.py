"""`adagmm-fusion simulate`: a rendered recording of two Kinects."""

import argparse

from adagmm_fusion.processes.terminal import printable


def add(commands: argparse._SubParsersAction) -> None:
    text = "Render a recording of two Kinects in a furnished room, with an exactly known rig."
    command = commands.add_parser("simulate", help="render a recording of two Kinects", description=text)
    command.add_argument("output", metavar="OUT", help="the recording's new folder")
    command.add_argument("--calibration", metavar="RIG", help="where to write the rig file (default: OUT/rig.yaml)")
    command.add_argument("--pairs", type=int, default=3, metavar="N", help="moments of the room (default: %(default)s)")
    command.add_argument("--seed", type=int, default=7, metavar="N", help="of room and noise (default: %(default)s)")
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Render the recording and write it to args.output; returns the exit code.

    Raises
    ------
    AdaGMMError  if the numbers make no recording, or the folder or the rig file cannot be written.
    """
    from adagmm_fusion.simulation.recording import simulate_recording

    rig = simulate_recording(args.output, pairs=args.pairs, seed=args.seed, calibration=args.calibration)
    print(printable(f"{args.output}: {args.pairs} pair(s), rig {rig}"))
    return 0
