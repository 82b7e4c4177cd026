"""The arguments that say which recording, and how to read it."""

import argparse
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from adagmm_fusion.recordings.frame_sequence import Recording


def add_recording_arguments(command: argparse.ArgumentParser) -> None:
    """RECORDING, --format, --calibration and --step."""
    from adagmm_fusion.formats import FORMATS

    command.add_argument("recording", metavar="RECORDING", help="the recording, a folder or video file")
    command.add_argument("--format", choices=sorted(FORMATS), help="the recording's format (default: looked for)")
    command.add_argument("--calibration", metavar="RIG", help="a rig file instead of the recording's own calibration")
    command.add_argument(
        "--step",
        type=int,
        default=1,
        metavar="N",
        help="frames between the two of a pair, for one moving sensor whose recording lists no pairs "
        "(default: %(default)s)",
    )


def recording_of(args: argparse.Namespace) -> "Recording":
    """Open what the arguments name. Raises RecordingError, RigError or InputError as open_recording does."""
    from adagmm_fusion.recordings.opening import open_recording

    return open_recording(args.recording, format=args.format, rig=args.calibration, step=args.step)


def print_notes(recording: "Recording") -> None:
    """A line for each thing that reading left out or took for granted, or that looks wrong; loads a few frames."""
    from adagmm_fusion.errors import one_line
    from adagmm_fusion.pairs.plausibility import recording_warnings

    for note in (*recording.notes, *recording_warnings(recording)):
        print(f"note: {one_line(note)}")
