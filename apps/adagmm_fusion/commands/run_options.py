"""The options of `adagmm-fusion run`; see run.py for one recording, run_many.py for a folder of them."""

import argparse
import logging
from collections.abc import Callable
from dataclasses import asdict, fields
from typing import Any

from adagmm_fusion.processes.interruption import heard_afterwards

SETTINGS_OPTIONS = {
    "sensor_model": "--sensor-model",
    "voxel_size_m": "--voxel-size",
    "target_points": "--target-points",
    "max_depth_m": "--max-depth",
    "partner_distance_m": "--partner-distance",
    "start": "--start",
    "color": "--color",
    "max_iteration": "--max-iteration",
    "device": "--device",
    "max_rotation_error_deg": "--max-rotation-error",
    "max_translation_error_mm": "--max-translation-error",
    "min_overlap": "--min-overlap",
}


def add(commands: argparse._SubParsersAction) -> None:
    from adagmm_fusion.clouds.sensor_models import sensor_models
    from adagmm_fusion.formats import FORMATS
    from adagmm_fusion.pairs.settings import COLORS, STARTS, Settings
    from adagmm_fusion.rerun_arguments import add_rerun_arguments

    default = {field.name: field.default for field in fields(Settings)}
    text = (
        "Register the pairs of a recording; write a report, fused clouds, the estimated rig and a Rerun recording. The "
        "exit code is 0 if pairs succeeded, 6 if all failed, and with --strict 5 if some did."
    )
    command = commands.add_parser("run", help="register the pairs of a recording", description=text)
    command.add_argument("recording", metavar="RECORDING", help="a folder, a video file, or a folder of many")
    command.add_argument("--calibration", metavar="RIG", help="a rig file instead of the recording's own calibration")
    command.add_argument("--format", choices=sorted(FORMATS), help="the recording's format (default: looked for)")
    command.add_argument(
        "--step",
        type=int,
        default=1,
        metavar="N",
        help="frames between source and target, for one moving sensor whose recording lists no pairs "
        "(default: %(default)s)",
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

    def add_setting(
        group: argparse._ArgumentGroup, name: str, type: Callable | None, metavar: str | None, help: str, **more: Any
    ) -> None:
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

    add_setting(method, "sensor_model", str, None, "where covariances come from", choices=sensor_models())
    add_setting(
        method, "voxel_size_m", float, "METRES", "edge of the averaging grid (default: as fits --target-points)"
    )
    add_setting(method, "target_points", int, "N", "points per cloud when the grid is chosen")
    add_setting(method, "max_depth_m", float, "METRES", "measurements farther away are ignored")
    add_setting(method, "start", str, None, "from the colour images' features or the clouds alone", choices=STARTS)
    add_setting(method, "color", str, None, "whether the points' colours count beside the geometry", choices=COLORS)
    add_setting(method, "max_iteration", int, "N", "EM iterations at most (default: the plugin's)")
    add_setting(method, "device", str, None, "where the kernels run", choices=("auto", "cpu", "cuda"))
    add_setting(success, "max_rotation_error_deg", float, "DEGREES", "with ground truth")
    add_setting(success, "max_translation_error_mm", float, "MM", "with ground truth")
    add_setting(
        success, "min_overlap", float, "SHARE", "without ground truth (default: 0.3; 0.15 where features agree)"
    )
    add_setting(
        success,
        "partner_distance_m",
        float,
        "METRES",
        "how near points count as overlapping (default: twice their mean distance)",
    )
    viewer = command.add_argument_group("Rerun", "Without one of these, the recording is saved with the other results.")
    viewer.add_argument("--no-rerun", action="store_true", help="make no Rerun recording")
    add_rerun_arguments(viewer)
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run over args.recording, or over every recording in it; returns the exit code.

    Raises
    ------
    AdaGMMError  if a setting, a recording or its rig cannot be used, or a result cannot be written.
    """
    with heard_afterwards():
        from adagmm_fusion.commands import run as one_recording
        from adagmm_fusion.commands.run_config import config_text
        from adagmm_fusion.commands.run_many import recordings_in, run_many
        from adagmm_fusion.errors import RecordingError
        from adagmm_fusion.pairs.settings import Settings

    settings = Settings(**{name: getattr(args, name) for name in SETTINGS_OPTIONS})
    if args.dump_config:
        print(config_text(asdict(settings)), end="")
        return 0
    if args.verbose or args.quiet:
        logging.basicConfig(level=logging.INFO if args.verbose else logging.ERROR, format="%(message)s")
    if recordings := recordings_in(args.recording):
        return run_many(recordings, args, settings)
    for option, value in (("--workers", args.workers), ("--scheduler", args.scheduler)):
        if value is not None:
            raise RecordingError(f"{args.recording}: one recording; {option} is for a folder of them")
    return one_recording.run(args, settings)
