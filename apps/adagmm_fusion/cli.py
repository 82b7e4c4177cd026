"""The command `adagmm-fusion`. Known errors end here: one line on stderr, exit code 1; so do Ctrl-C and SIGTERM.

Little is imported before signals are heard: Open3D and Numba take a second.
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import fields
from importlib import metadata

from adagmm_fusion.processes.interruption import exit_code, heard_afterwards, signals_as_interrupts, word_for
from adagmm_fusion.processes.terminal import printable, printing, say

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
    from adagmm_fusion.commands import calibrate, convert, convert_rig, fuse, info, verify

    top = argparse.ArgumentParser(prog="adagmm-fusion", description="Register and fuse recorded RGB-D pairs.")
    top.add_argument("--version", action="version", version=f"%(prog)s {metadata.version('adagmm-o3d')}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    _add_run(commands)
    _add_simulate(commands)
    info.add(commands)
    convert.add(commands)
    calibrate.add(commands)
    convert_rig.add(commands)
    verify.add(commands)
    fuse.add(commands)
    return top


def _add_run(commands) -> None:
    from adagmm_fusion.clouds.building import SENSOR_MODELS
    from adagmm_fusion.formats import FORMATS
    from adagmm_fusion.pairs.settings import STARTS, Settings
    from adagmm_fusion.rerun_log import add_rerun_arguments

    default = {field.name: field.default for field in fields(Settings)}
    text = "Register the pairs of a recording; write a report, fused clouds, the estimated rig and a Rerun recording."
    command = commands.add_parser("run", help="register the pairs of a recording", description=text)
    command.add_argument("recording", metavar="RECORDING", help="a folder, or one of many; see recordings/README.md")
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

    add(method, "sensor_model", str, None, "where covariances come from", choices=SENSOR_MODELS)
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
    command = commands.add_parser("simulate", help="render a recording of two Kinects", description=text)
    command.add_argument("output", metavar="OUT", help="the recording's new folder")
    command.add_argument("--calibration", metavar="RIG", help="where to write the rig file (default: OUT/rig.yaml)")
    command.add_argument("--pairs", type=int, default=3, metavar="N", help="moments of the room (default: %(default)s)")
    command.add_argument("--seed", type=int, default=7, metavar="N", help="of room and noise (default: %(default)s)")
    command.set_defaults(run=_simulate)


def _run(args: argparse.Namespace) -> int:
    from adagmm_fusion.commands.run import run
    from adagmm_fusion.commands.run_many import recordings_in, run_many
    from adagmm_fusion.pairs.settings import Settings

    settings = Settings(**{name: getattr(args, name) for name in SETTINGS_OPTIONS})
    recordings = recordings_in(args.recording)
    return run_many(recordings, args, settings) if recordings else run(args, settings)


def _simulate(args: argparse.Namespace) -> int:
    from adagmm_fusion.simulation.recording import simulate_recording

    rig = simulate_recording(args.output, pairs=args.pairs, seed=args.seed, calibration=args.calibration)
    print(printable(f"{args.output}: {args.pairs} pair(s), rig {rig}"))
    return 0
