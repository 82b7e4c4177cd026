"""`adagmm-fusion calibrate`: a rig file from images of a board, or from what its sensors see."""

import argparse
from pathlib import Path

from adagmm_fusion.processes.terminal import printable, say, table_console


def add(commands: argparse._SubParsersAction) -> None:
    text = (
        "Find intrinsics, distortion and extrinsics of a rig from images of a chessboard or ChArUco board that its "
        "sensors saw at the same moments. IMAGES has a folder SENSOR/color for each sensor, and SENSOR/depth to check "
        "its depth unit. With --from-scene, without a board: the extrinsics of sensors that stand still, from a "
        "recording of what they see."
    )
    command = commands.add_parser(
        "calibrate", help="make a rig file from images of a board, or of any scene", description=text
    )
    command.add_argument("images", metavar="IMAGES", nargs="?", help="the folder of board images")
    board = command.add_mutually_exclusive_group(required=True)
    board.add_argument("--chessboard", metavar="CxR", help="inner corners of a plain chessboard, as 9x6")
    board.add_argument("--charuco", metavar="CxR", help="squares of a ChArUco board, as 8x6")
    board.add_argument(
        "--from-scene", metavar="RECORDING", help="no board: what fixed sensors see; see calibrate_scene"
    )
    command.add_argument("--square", type=float, metavar="METRES", help="edge of a square")
    command.add_argument("--marker", type=float, metavar="METRES", help="edge of a ChArUco marker")
    command.add_argument("--dictionary", default="4X4_50", help="of the ChArUco markers (default: %(default)s)")
    command.add_argument(
        "--distortion",
        type=int,
        default=5,
        choices=(0, 4, 5, 8),
        help="number of lens distortion coefficients (default: %(default)s)",
    )
    command.add_argument(
        "--depth-scale",
        type=float,
        default=1000.0,
        metavar="UNITS",
        help="depth units per metre, checked where there is depth (default: %(default)g)",
    )
    command.add_argument("--output", metavar="RIG", help="the rig file (default: calibration/<name of IMAGES>.yaml)")
    command.set_defaults(run=run, usage_error=command.error)


def run(args: argparse.Namespace) -> int:
    """Calibrate and write the rig file; returns the exit code.

    Raises
    ------
    AdaGMMError  if the images do not make a rig, or the file cannot be written.
    """
    if (args.from_scene is None) == (args.images is None):
        args.usage_error("expected IMAGES of a board, or --from-scene RECORDING, and not both")
    if args.from_scene is not None:
        return _from_scene(args)
    if args.square is None:
        args.usage_error("the following arguments are required: --square")
    return _from_board(args)


def _from_scene(args: argparse.Namespace) -> int:
    import json

    import numpy as np

    from adagmm_fusion.commands.progress import staged_progress_bar
    from adagmm_fusion.commands.recording_arguments import print_notes
    from adagmm_fusion.files.atomic_file import check_output_file, write_text
    from adagmm_fusion.pairs.settings import Settings
    from adagmm_fusion.recordings.opening import open_recording
    from adagmm_fusion.rigs.rig import save_rig
    from adagmm_fusion.rigs.scene_calibration import calibrate_from_scene

    recording = open_recording(args.from_scene)
    name = recording.path.resolve().name
    output = Path(args.output) if args.output else Path("calibration") / f"{name}.yaml"
    beside = output.with_name(f"{output.stem}_covariances.json")
    for path in (output, beside):
        check_output_file(path)
    with staged_progress_bar() as report:
        result = calibrate_from_scene(recording, Settings(), name=name, on_pair=report)
    save_rig(output, result.rig)
    known = {
        "of": "(omega, v) in T_rig_sensor exp(omega, v) [rad, m]",
        "covariances": {sensor: matrix.tolist() for sensor, matrix in result.covariances.items()},
        "edges": [edge.name for edge in result.edges],
        "disagreeing": result.disagreeing,
        "failed": result.failed,
    }
    write_text(beside, json.dumps(known, indent=1) + "\n")
    print(f"{len(result.edges)} of {len(result.edges) + len(result.failed)} pairs registered")
    for sensor, matrix in result.covariances.items():
        turn, shift = (float(np.sqrt(np.trace(block))) for block in (matrix[:3, :3], matrix[3:, 3:]))
        print(printable(f"{sensor}: known to {np.degrees(turn):.3f} deg and {1000 * shift:.1f} mm"))
    for pair in result.disagreeing:
        say(f"adagmm-fusion: {printable(pair)} disagrees with the other pairs and counts for little")
    for pair, reason in result.failed.items():
        say(f"adagmm-fusion: {printable(pair)} was not registered: {printable(reason)}")
    print_notes(recording)
    print(printable(f"rig: {output}, covariances: {beside}"))
    return 0


def _from_board(args: argparse.Namespace) -> int:
    from adagmm_fusion.board_calibration.boards import Charuco, Chessboard, parse_board_size
    from adagmm_fusion.board_calibration.report import calibration_tables
    from adagmm_fusion.board_calibration.rig_calibration import calibrate_rig
    from adagmm_fusion.board_calibration.views import find_boards
    from adagmm_fusion.commands.progress import progress_bar
    from adagmm_fusion.files.atomic_file import check_output_file
    from adagmm_fusion.rigs.rig import save_rig
    from adagmm_o3d.errors import InputError

    if not 0 < args.depth_scale < float("inf"):
        raise InputError(f"--depth-scale: expected positive depth units per metre, got {args.depth_scale}")
    board: Chessboard | Charuco
    if args.charuco:
        if args.marker is None:
            raise InputError("--marker: give the edge of the ChArUco board's markers [m]")
        board = Charuco(*parse_board_size(args.charuco, "--charuco"), args.square, args.marker, args.dictionary)
    else:
        board = Chessboard(*parse_board_size(args.chessboard, "--chessboard"), args.square)
    folder = Path(args.images)
    name = folder.resolve().name
    output = Path(args.output) if args.output else Path("calibration") / f"{name}.yaml"
    check_output_file(output)
    with progress_bar(f"boards in {name}") as report:
        views = find_boards(folder, board, on_image=report)
    result = calibrate_rig(
        views, board, name=name, folder=folder, coefficients=args.distortion, depth_scale=args.depth_scale
    )
    save_rig(output, result.rig)
    console = table_console()
    for table in calibration_tables(result, views):
        console.print(table)
    for warning in result.warnings:
        say(f"adagmm-fusion: {printable(warning)}")
    print(printable(f"rig: {output}"))
    return 0
