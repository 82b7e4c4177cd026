"""`adagmm-fusion info`: what is in a recording."""

import argparse

from adagmm_fusion.commands.recording_arguments import add_recording_arguments, print_notes, recording_of
from adagmm_fusion.processes.terminal import printable, say, table_console


def add(commands: argparse._SubParsersAction) -> None:
    text = "Read all of a recording and say what is in it. The exit code is 1 if some of it cannot be read."
    command = commands.add_parser("info", help="say what is in a recording", description=text)
    add_recording_arguments(command)
    command.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print tables about args.recording; returns the exit code, 1 if a frame cannot be read.

    Raises
    ------
    AdaGMMError  if the recording cannot be opened.
    """
    from adagmm_fusion.commands.progress import progress_bar
    from adagmm_fusion.recordings.summary import summarize_recording, summary_tables

    recording = recording_of(args)
    with progress_bar(recording.name) as report:
        summary = summarize_recording(recording, on_frame=report)
    console = table_console()
    for table in summary_tables(summary):
        console.print(table)
    print_notes(recording)
    for problem in summary.problems:
        say(f"adagmm-fusion: {printable(' '.join(problem.split()))}")
    return 1 if summary.problems else 0
