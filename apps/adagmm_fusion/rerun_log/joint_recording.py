"""Several Rerun recordings and an overview of them in one file: the viewer lists them, and one picks from these."""

import argparse
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import rerun.blueprint as rrb

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import check_output_file, replacing
from adagmm_fusion.rerun_arguments import add_rerun_arguments
from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.headless_viewer import RERUN
from adagmm_fusion.rerun_log.streams import open_stream
from adagmm_fusion.rerun_log.words import markdown

HINT = (
    "The panel on the left (a button at the top right opens it) has these recordings: a click on *adagmm_fusion* there "
    "lists them with what was found, to be sorted and picked from."
)


def save_joint_recording(path: Path, title: str, overview: str, recordings: Sequence[Path]) -> None:
    """Write `recordings` (.rrd files) and a page of markdown into one file. Raises OutputError if it cannot be done."""
    check_output_file(path)
    parser = argparse.ArgumentParser()
    add_rerun_arguments(parser)
    with tempfile.TemporaryDirectory() as folder:
        first = Path(folder) / "overview.rrd"
        view = rrb.TextDocumentView(name="All recordings", origin=entities.SUMMARY_TABLE)
        blueprint = rrb.Blueprint(view, rrb.TimePanel(state="hidden"), auto_layout=False, auto_views=False)
        with open_stream(
            parser.parse_args(["--save", str(first)]), f"{title}: all recordings", blueprint, kind="all"
        ) as rec:
            rec.log(entities.SUMMARY_TABLE, markdown(f"{overview}\n\n{HINT}"), static=True)
        with replacing(path) as temporary:
            command = [str(RERUN), "rrd", "merge", str(first), *map(str, recordings), "-o", str(temporary)]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                raise OutputError(f"{path}: the recordings cannot be joined: {' '.join(done.stderr.split())[-300:]}")
