"""A picture of a Rerun recording as the viewer shows it, on a machine without a display.

    python -m adagmm_fusion.rerun_log.picture RECORDING.rrd PICTURE.jpg [--page Why] [--time iteration=0] [--width 1280]

It needs a Vulkan driver; a software one will do (Debian: mesa-vulkan-drivers libvulkan1).
"""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import rerun_cli
from rerun.experimental import ViewerClient

from adagmm_fusion.errors import OutputError, RecordingError
from adagmm_fusion.files.atomic_file import check_output_file, replacing
from adagmm_fusion.files.input_file import check_input
from adagmm_fusion.rerun_log.streams import free_port
from adagmm_o3d.errors import AdaGMMError, InputError

RERUN = Path(rerun_cli.__file__).parent / "rerun"
LOADING_SECONDS = RESTING_SECONDS = 120.0
SECONDS_BETWEEN_LOOKS = 0.1
JPEG_QUALITY = 85


@contextlib.contextmanager
def headless_viewer(path: Path) -> Iterator[ViewerClient]:
    """The real viewer with a recording loaded, ended with the block.

    Raises
    ------
    RecordingError  if the file is not there or does not load.    OutputError  if the viewer cannot be started.
    """
    check_input(Path(path), RecordingError, missing="no such Rerun recording")
    os.environ.setdefault("RUST_LOG", "error")
    try:
        started = ViewerClient.spawn(
            headless=True, port=free_port(), hide_welcome_screen=True, executable_path=str(RERUN)
        )
    except RuntimeError as error:
        raise OutputError(f"rerun viewer: could not be started: {error}") from error
    with started as viewer:
        viewer.open(str(path))
        give_up = time.monotonic() + LOADING_SECONDS
        while viewer.get_state().loading:
            if time.monotonic() > give_up:
                raise RecordingError(f"{path}: still loading after {LOADING_SECONDS:g} s")
            time.sleep(SECONDS_BETWEEN_LOOKS)
        yield viewer


def screenshot(viewer: ViewerClient, view_id: str | None = None) -> np.ndarray:
    """(H, W, 3) uint8 RGB of the window or of one view, taken again until two are equal: the first is not final.

    Raises
    ------
    OutputError  if the viewer makes no picture, or it does not come to rest.
    """
    before, problem = None, "the picture still changed"
    give_up = time.monotonic() + RESTING_SECONDS
    while time.monotonic() < give_up:
        try:
            png = viewer.take_screenshot(view_id)
        except ConnectionError as error:  # a busy machine paints too late for one screenshot
            problem = str(error).split("\n")[0]
        else:
            if png == before:
                return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
            before, problem = png, "the picture still changed"
        time.sleep(SECONDS_BETWEEN_LOOKS)
    raise OutputError(f"rerun viewer: {problem} after {RESTING_SECONDS:g} s")


def show_page(viewer: ViewerClient, name: str) -> None:
    """Bring the page of that name to the front, as a click on its tab does.

    Raises
    ------
    InputError  if the dashboard has no such page.
    """
    blueprint = viewer.get_blueprint().blueprint
    containers = {path: fields.get("ContainerBlueprint", {}) for path, fields in blueprint.items()}
    names = {fields["display_name"]: path for path, fields in containers.items() if "display_name" in fields}
    pages = {name: path.removeprefix("/") for name, path in names.items()}  # the viewer writes it with and without
    if name not in pages:
        raise InputError(f"page: expected one of {', '.join(sorted(pages)) or 'none'}, got {name!r}")
    for fields in containers.values():
        if pages[name] in (path.removeprefix("/") for path in fields.get("contents", ())):
            fields["active_tab"] = pages[name]
    viewer.set_blueprint(blueprint, of="recording")


def save_picture(
    recording: Path,
    picture: Path,
    *,
    page: str | None = None,
    at: tuple[str, int] | None = None,
    width: int = 1280,
) -> None:
    """Write a picture of the viewer's window, of a page of the dashboard, `at` a timeline and its number.

    width : [px], to which the window is scaled.
    """
    check_output_file(picture)
    with headless_viewer(recording) as viewer:
        if page is not None:
            show_page(viewer, page)
        if at is not None:
            viewer.set_time(at[0], sequence=at[1], play_state="paused")
        window = screenshot(viewer)
    height = round(window.shape[0] * width / window.shape[1])
    small = cv2.resize(window, (width, height), interpolation=cv2.INTER_AREA)
    try:
        complete, data = cv2.imencode(picture.suffix, small[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    except cv2.error as error:
        raise OutputError(f"{picture}: expected a name ending in .jpg or .png") from error
    if not complete:
        raise OutputError(f"{picture}: the picture could not be encoded")
    with replacing(picture) as temporary:
        temporary.write_bytes(data.tobytes())


def main(arguments: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m adagmm_fusion.rerun_log.picture", description=__doc__.split("\n")[0]
    )
    parser.add_argument("recording", type=Path, help="a .rrd file")
    parser.add_argument("picture", type=Path, help="where the .jpg or .png goes")
    parser.add_argument("--page", help="Summary, Pair or Why (default: where it opens)")
    parser.add_argument("--time", metavar="TIMELINE=N", help="e.g. iteration=0 or frame=3 (default: where it opens)")
    parser.add_argument("--width", type=int, default=1280, help="in pixels (default: %(default)s)")
    args = parser.parse_args(arguments)
    try:
        save_picture(args.recording, args.picture, page=args.page, at=_parsed_time(args.time), width=args.width)
    except AdaGMMError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _parsed_time(text: str | None) -> tuple[str, int] | None:
    if text is None:
        return None
    timeline, _, number = text.partition("=")
    if not timeline or not number.isdigit():
        raise InputError(f"--time: expected TIMELINE=N as in iteration=0, got {text!r}")
    return timeline, int(number)


if __name__ == "__main__":
    sys.exit(main())
