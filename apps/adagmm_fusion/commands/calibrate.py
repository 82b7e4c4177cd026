"""`adagmm-fusion calibrate`: a rig file from images of a board."""

import argparse
from pathlib import Path

from adagmm_fusion.processes.terminal import printable, say

TABLE_WIDTH = 150  # where the output is no terminal


def add(commands: argparse._SubParsersAction) -> None:
    text = (
        "Find intrinsics, distortion and extrinsics of a rig from images of a chessboard or ChArUco board that its "
        "sensors saw at the same moments. IMAGES has a folder SENSOR/color for each sensor, and SENSOR/depth to check "
        "its depth unit."
    )
    command = commands.add_parser("calibrate", help="make a rig file from images of a board", description=text)
    command.add_argument("images", metavar="IMAGES", help="the folder of board images")
    board = command.add_mutually_exclusive_group(required=True)
    board.add_argument("--chessboard", metavar="CxR", help="inner corners of a plain chessboard, as 9x6")
    board.add_argument("--charuco", metavar="CxR", help="squares of a ChArUco board, as 8x6")
    command.add_argument("--square", type=float, required=True, metavar="METRES", help="edge of a square")
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
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Calibrate and write the rig file; returns the exit code.

    Raises
    ------
    AdaGMMError  if the images do not make a rig, or the file cannot be written.
    """
    from rich.console import Console

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
    console = Console(highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console = Console(highlight=False, soft_wrap=True, width=TABLE_WIDTH)
    for table in calibration_tables(result, views):
        console.print(table)
    for warning in result.warnings:
        say(f"adagmm-fusion: {printable(warning)}")
    print(printable(f"rig: {output}"))
    return 0
