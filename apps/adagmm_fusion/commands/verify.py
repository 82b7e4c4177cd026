"""`adagmm-fusion verify`: has a sensor of a rig moved since it was calibrated?"""

import argparse
from typing import Any

from adagmm_fusion.commands.recording_arguments import print_notes
from adagmm_fusion.processes.terminal import printable, table_console

EXIT_CODES = {"unchanged": 0, "moved": 3, "undecided": 4}


def add(commands: argparse._SubParsersAction) -> None:
    from adagmm_fusion.formats import FORMATS
    from adagmm_fusion.rerun_arguments import add_rerun_arguments

    text = (
        "Register the clouds of several moments, starting from the rig's pose, and say how far the sensors have moved. "
        "The recording must have frames of two sensors at one moment. The exit code is 0 if no sensor has moved, 3 if "
        "one has, 4 if that cannot be said: the frames disagree, or too few could be registered."
    )
    command = commands.add_parser("verify", help="say whether a rig's calibration is still true", description=text)
    command.add_argument("rig", metavar="RIG", help="the rig file; its intrinsics replace the recording's")
    command.add_argument("recording", metavar="RECORDING", help="the recording, a folder or video file")
    command.add_argument("--format", choices=sorted(FORMATS), help="the recording's format (default: looked for)")
    command.add_argument("--frames", type=int, default=10, metavar="N", help="moments at most (default: %(default)s)")
    command.add_argument(
        "--max-rotation",
        type=float,
        default=1.0,
        metavar="DEGREES",
        help="up to which a sensor counts as unmoved (default: %(default)g)",
    )
    command.add_argument(
        "--max-translation",
        type=float,
        default=50.0,
        metavar="MM",
        help="up to which a sensor counts as unmoved (default: %(default)g)",
    )
    command.add_argument(
        "--device", choices=("auto", "cpu", "cuda"), default="auto", help="where the kernels run (default: %(default)s)"
    )
    add_rerun_arguments(command.add_argument_group("Rerun", "Shows or saves where the sensors are, and should be."))
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print how far each sensor is from where args.rig says; returns the exit code of the worst verdict.

    Raises
    ------
    AdaGMMError  if rig or recording cannot be used.
    """
    from adagmm_fusion.commands.progress import progress_bar
    from adagmm_fusion.files.output_folder import check_apart
    from adagmm_fusion.pairs.settings import Settings
    from adagmm_fusion.recordings.opening import open_recording
    from adagmm_fusion.rerun_log import check_destination
    from adagmm_fusion.rigs.checking import MIN_FRAMES, check_rig
    from adagmm_fusion.rigs.rig import load_rig
    from adagmm_o3d.errors import InputError

    if args.frames < MIN_FRAMES:
        raise InputError(f"--frames: expected at least {MIN_FRAMES}, got {args.frames}")
    for name in ("max_rotation", "max_translation"):
        if not 0 < getattr(args, name) < float("inf"):
            raise InputError(f"--{name.replace('_', '-')}: expected a positive number, got {getattr(args, name)}")
    check_destination(args)
    rig = load_rig(args.rig)
    recording = open_recording(args.recording, format=args.format, rig=rig)
    check_apart(recording.path, None, args.save)
    with progress_bar(recording.name) as report:
        checks = check_rig(
            rig,
            recording,
            Settings(device=args.device),
            max_rotation_deg=args.max_rotation,
            max_translation_mm=args.max_translation,
            max_frames=args.frames,
            on_frame=report,
        )
    console = table_console()
    for check in checks:
        console.print(_table(check))
        console.print(printable(_sentence(check)), markup=False)
    print_notes(recording)
    if args.save or args.connect or args.serve or args.url or args.stdout:
        _show(args, checks, rig)
    verdicts = {check.verdict for check in checks}
    return next(EXIT_CODES[verdict] for verdict in ("moved", "undecided", "unchanged") if verdict in verdicts)


def _show(args: argparse.Namespace, checks: list, rig: Any) -> None:
    """Log what moved to Rerun, as the arguments say."""
    from adagmm_fusion.rerun_log import log_verified_rig, open_stream, verified_rig_blueprint

    with open_stream(args, rig.name, verified_rig_blueprint(checks, rig), kind="verify") as stream:
        log_verified_rig(stream, checks, rig)


def _table(check):
    from rich.table import Table
    from rich.text import Text

    table = Table()
    for heading in ("frame", "rotation [°]", "translation [mm]", ""):
        table.add_column(Text(heading), justify="left" if heading in ("frame", "") else "right", overflow="fold")
    for frame in check.frames:
        moved = ["", ""]
        if frame.T_target_source is not None:
            moved = [
                _with_sigma(frame.rotation_deg, frame.rotation_sigma_deg, 2),
                _with_sigma(frame.translation_mm, frame.translation_sigma_mm, 1),
            ]
        table.add_row(Text(frame.frame), *moved, Text(frame.reason))
    return table


def _with_sigma(value: float, sigma: float | None, digits: int) -> str:
    """The value and its standard deviation by the pose covariance, where there is one."""
    return f"{value:.{digits}f}" + ("" if sigma is None else f" ± {sigma:.{digits}f}")


def _sentence(check: Any) -> str:
    if check.T_target_source is None:
        good = sum(frame.T_target_source is not None for frame in check.frames)
        return f"{check.source} against {check.target}: undecided, {good} of {len(check.frames)} frames registered"
    return (
        f"{check.source} against {check.target}: {check.verdict}, {check.rotation_deg:.2f}° ± "
        f"{check.rotation_spread_deg:.2f}° and {check.translation_mm:.1f} mm ± {check.translation_spread_mm:.1f} mm "
        "from the rig file (± is the spread over frames; in the table, what each pose's own covariance says)"
        + (f"; the rig file's pose looks like {check.looks_like}" if check.looks_like else "")
    )
