"""The command `adagmm-fusion`. Known errors end here: one line on stderr, exit code 1; so do Ctrl-C and SIGTERM.

A command's modules are imported when it is the one that runs: Open3D, Numba and Rerun take a second each.
"""

import argparse
import importlib
import sys
from collections.abc import Callable, Sequence

from adagmm_fusion.completion import add_completion
from adagmm_fusion.missing_library import explain
from adagmm_fusion.processes.interruption import Terminated, exit_code, heard_afterwards, signals_as_interrupts

SETTINGS_OPTIONS = {
    "sensor_model": "--sensor-model",
    "voxel_size_m": "--voxel-size",
    "target_points": "--target-points",
    "max_depth_m": "--max-depth",
    "partner_distance_m": "--partner-distance",
    "start": "--start",
    "max_iteration": "--max-iteration",
    "device": "--device",
    "max_rotation_error_deg": "--max-rotation-error",
    "max_translation_error_mm": "--max-translation-error",
    "min_overlap": "--min-overlap",
}
# The commands, and what the list of them says of each.
COMMANDS = {
    "run": "register the pairs of a recording",
    "simulate": "render a recording of two Kinects",
    "info": "say what is in a recording",
    "convert": "write a recording in our own layout",
    "calibrate": "make a rig file from images of a board",
    "convert-rig": "make a rig file of ROS or OpenCV calibrations",
    "verify": "say whether a rig's calibration is still true",
    "fuse": "fuse a whole recording into one mesh",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    try:
        with signals_as_interrupts():
            return _run_command(arguments)
    except KeyboardInterrupt as stop:
        print(f"adagmm-fusion: {'terminated' if isinstance(stop, Terminated) else 'interrupted'}", file=sys.stderr)
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

                arguments = with_config(arguments, SETTINGS_OPTIONS)
            args = command_line.parse_args(arguments)
            return args.run(args)
        except AdaGMMError as problem:
            print(f"adagmm-fusion: {one_line(problem)}", file=sys.stderr)
            return 1
    except (ImportError, OSError) as problem:
        if (line := explain(problem)) is None:
            raise
        print(f"adagmm-fusion: {line}", file=sys.stderr)
        return 1


def parser(filled_in: Sequence[str] = tuple(COMMANDS)) -> argparse.ArgumentParser:
    """The command line's grammar; commands other than those named are in it without their options."""
    top = argparse.ArgumentParser(prog="adagmm-fusion", description="Register and fuse recorded RGB-D pairs.")
    top.add_argument("--version", action=_PrintVersion, nargs=0, help="show program's version number and exit")
    add_completion(top, parser)
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    ours = {"run": _add_run, "simulate": _add_simulate}
    for name, summary in COMMANDS.items():
        if name not in filled_in:
            commands.add_parser(name, help=summary)
        elif name in ours:
            ours[name](commands)
        else:
            importlib.import_module(f"adagmm_fusion.commands.{name.replace('-', '_')}").add(commands)
    return top


class _PrintVersion(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None) -> None:
        from importlib import metadata

        print(f"{parser.prog} {metadata.version('adagmm-o3d')}")
        parser.exit()


def _add_run(commands) -> None:
    from dataclasses import fields

    from adagmm_fusion.clouds.sensor_models import sensor_models
    from adagmm_fusion.commands.rerun_arguments import add_rerun_arguments
    from adagmm_fusion.formats import FORMATS
    from adagmm_fusion.pairs.settings import STARTS, Settings

    default = {field.name: field.default for field in fields(Settings)}
    text = (
        "Register the pairs of a recording; write a report, fused clouds, the estimated rig and a Rerun recording. The "
        "exit code is 0 if pairs succeeded, 6 if all failed, and with --strict 5 if some did."
    )
    command = commands.add_parser("run", help=COMMANDS["run"], description=text)
    command.add_argument("recording", metavar="RECORDING", help="a folder, a video file, or a folder of many")
    command.add_argument("--calibration", metavar="RIG", help="a rig file instead of the recording's own calibration")
    command.add_argument("--format", choices=sorted(FORMATS), help="the recording's format (default: looked for)")
    command.add_argument(
        "--step",
        type=int,
        default=1,
        metavar="N",
        help="frames between source and target, for one "
        "moving sensor whose recording lists no pairs (default: %(default)s)",
    )
    command.add_argument("--pairs", metavar="LIST", help="which pairs, as in 0,3,5-7 (default: all)")
    command.add_argument("--output", metavar="DIR", help="where results go (default: output/<recording>)")
    command.add_argument("--workers", type=int, metavar="N", help="for a folder of recordings: local processes")
    command.add_argument("--scheduler", metavar="ADDRESS", help="for a folder of recordings: a Dask cluster instead")
    command.add_argument("--no-clouds", action="store_true", help="write neither fused clouds nor textured meshes")
    command.add_argument("--strict", action="store_true", help="exit with 5 where some pairs failed, instead of 0")
    command.add_argument("--config", metavar="FILE", help="settings from a file as --dump-config prints it")
    command.add_argument("--dump-config", action="store_true", help="print the settings as such a file, and end")
    loudness = command.add_mutually_exclusive_group()
    loudness.add_argument("-v", "--verbose", action="store_true", help="log what is chosen on the way, too")
    loudness.add_argument("-q", "--quiet", action="store_true", help="print nothing but errors")
    method = command.add_argument_group("method")
    success = command.add_argument_group("what counts as success")

    def add(group, name: str, type: Callable | None, metavar: str | None, help: str, **more) -> None:
        automatic = "" if default[name] is None else " (default: %(default)s)"
        group.add_argument(
            SETTINGS_OPTIONS[name],
            dest=name,
            type=type,
            metavar=metavar,
            default=default[name],
            help=help + automatic,
            **more,
        )

    add(method, "sensor_model", str, None, "where covariances come from", choices=sensor_models())
    add(method, "voxel_size_m", float, "METRES", "edge of the averaging grid (default: as fits --target-points)")
    add(method, "target_points", int, "N", "points per cloud when the grid is chosen")
    add(method, "max_depth_m", float, "METRES", "measurements farther away are ignored")
    add(method, "start", str, None, "from the colour images' features or the clouds alone", choices=STARTS)
    add(method, "max_iteration", int, "N", "EM iterations at most (default: the plugin's)")
    add(method, "device", str, None, "where the kernels run", choices=("auto", "cpu", "cuda"))
    add(success, "max_rotation_error_deg", float, "DEGREES", "with ground truth")
    add(success, "max_translation_error_mm", float, "MM", "with ground truth")
    add(success, "min_overlap", float, "SHARE", "without ground truth")
    add(
        success,
        "partner_distance_m",
        float,
        "METRES",
        "how near points count as overlapping (default: twice their mean distance)",
    )
    viewer = command.add_argument_group("Rerun", "Without one of these, the recording is saved with the other results.")
    viewer.add_argument("--no-rerun", action="store_true", help="make no Rerun recording")
    add_rerun_arguments(viewer)
    command.set_defaults(run=_run)


def _add_simulate(commands) -> None:
    text = "Render a recording of two Kinects in a furnished room, with an exactly known rig."
    command = commands.add_parser("simulate", help=COMMANDS["simulate"], description=text)
    command.add_argument("output", metavar="OUT", help="the recording's new folder")
    command.add_argument("--calibration", metavar="RIG", help="where to write the rig file (default: OUT/rig.yaml)")
    command.add_argument("--pairs", type=int, default=3, metavar="N", help="moments of the room (default: %(default)s)")
    command.add_argument("--seed", type=int, default=7, metavar="N", help="of room and noise (default: %(default)s)")
    command.set_defaults(run=_simulate)


def _run(args: argparse.Namespace) -> int:
    import logging
    from dataclasses import asdict

    with heard_afterwards():
        from adagmm_fusion.commands.run import run
        from adagmm_fusion.commands.run_config import config_text
        from adagmm_fusion.commands.run_many import recordings_in, run_many
        from adagmm_fusion.pairs.settings import Settings

    settings = Settings(**{name: getattr(args, name) for name in SETTINGS_OPTIONS})
    if args.dump_config:
        print(config_text(asdict(settings)), end="")
        return 0
    if args.verbose or args.quiet:
        logging.basicConfig(level=logging.INFO if args.verbose else logging.ERROR, format="%(message)s")
    recordings = recordings_in(args.recording)
    return run_many(recordings, args, settings) if recordings else run(args, settings)


def _simulate(args: argparse.Namespace) -> int:
    from adagmm_fusion.simulation.recording import simulate_recording

    rig = simulate_recording(args.output, pairs=args.pairs, seed=args.seed, calibration=args.calibration)
    print(f"{args.output}: {args.pairs} pair(s), rig {rig}")
    return 0
