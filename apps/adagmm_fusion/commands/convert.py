"""`adagmm-fusion convert`: any recording in our own layout."""

import argparse

from adagmm_fusion.commands.recording_arguments import add_recording_arguments, print_notes, recording_of
from adagmm_fusion.processes.terminal import printable


def add(commands: argparse._SubParsersAction) -> None:
    text = "Write a recording in our own layout: images without loss, rig file, timestamps, poses and pairs."
    command = commands.add_parser("convert", help="write a recording in our own layout", description=text)
    add_recording_arguments(command)
    command.add_argument("output", metavar="OUT", help="the new folder; it appears when it is complete")
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Convert args.recording; returns the exit code.

    Raises
    ------
    AdaGMMError  if the recording cannot be read or does not fit the layout, or the folder cannot be written or holds
        something.
    """
    from adagmm_fusion.commands.progress import progress_bar
    from adagmm_fusion.recordings.writer import convert_recording, with_plain_names

    recording = with_plain_names(recording_of(args))
    with progress_bar(recording.name) as report:
        manifest = convert_recording(recording, args.output, on_frame=report)
    frames = f"{len(recording.entries)} frame(s) of {', '.join(recording.sensors)}"
    print(printable(f"{manifest}: {frames}, {len(recording)} pair(s)"))
    print_notes(recording)
    return 0
