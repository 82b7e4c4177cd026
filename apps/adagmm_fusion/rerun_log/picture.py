"""A picture of a Rerun recording as the viewer shows it, on a machine without a display.

    python -m adagmm_fusion.rerun_log.picture RECORDING.rrd PICTURE.jpg [--page Why] [--size 1600x1000] [--theme light]

It needs a Vulkan driver; a software one will do (Debian: mesa-vulkan-drivers libvulkan1).
"""

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rerun.experimental import ViewerClient

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import check_output_file, replacing
from adagmm_fusion.rerun_log.headless_viewer import (
    NO_ANSWER,
    SECONDS_BETWEEN_LOOKS,
    THEMES,
    Theme,
    first_line,
    headless_viewer,
)
from adagmm_o3d.errors import AdaGMMError, InputError

RESTING_SECONDS = 120.0
JPEG_QUALITY = 85
# The bar on top says what machine the viewer runs on, and nothing of the recording.
TOP_BAR_PX = 37


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
        except NO_ANSWER as error:  # a busy machine paints too late for one screenshot
            problem = first_line(error)
        else:
            if png == before:
                return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
            before, problem = png, "the picture still changed"
        time.sleep(SECONDS_BETWEEN_LOOKS)
    raise OutputError(f"rerun viewer: {problem} after {RESTING_SECONDS:g} s")


def show_page(viewer: ViewerClient, name: str) -> None:
    """Bring the page or the view of that name to the front, as clicks on the tabs that it is behind do.

    Raises
    ------
    InputError  if the dashboard has neither.
    """
    blueprint = viewer.get_blueprint().blueprint
    containers: dict[str, dict[str, Any]] = {}
    names: dict[str, str] = {}
    for path, archetypes in blueprint.items():
        shown = path.removeprefix("/")  # the viewer writes it with and without
        for archetype, fields in archetypes.items():
            if archetype == "ContainerBlueprint":
                containers[shown] = fields
            if "display_name" in fields:
                names.setdefault(fields["display_name"], shown)
    if name not in names:
        raise InputError(f"page: expected one of {', '.join(sorted(names)) or 'none'}, got {name!r}")
    front: str | None = names[name]
    while front is not None:
        behind = None
        for path, fields in containers.items():
            if front in (content.removeprefix("/") for content in fields.get("contents", ())):
                fields["active_tab"], behind = front, path
        front = behind
    viewer.set_blueprint(blueprint, of="recording")


def save_picture(
    recording: Path,
    picture: Path,
    *,
    page: str | None = None,
    at: tuple[str, int] | None = None,
    selected: str | None = None,
    size: tuple[int, int] = (1280, 720),
    theme: Theme = "dark",
) -> None:
    """Write a picture of the viewer's window below its top bar, of a page of the dashboard, `at` a timeline and number.

    page : the name of a page, or of a view that is behind a tab.
    selected : an entity, or one of its points as in world/source/points[#7], which the panel beside the page tells of.
    size : (width, height) [px] of the window.
    """
    check_output_file(picture)
    with headless_viewer(recording, size=size, theme=theme) as viewer:
        if page is not None:
            show_page(viewer, page)
        if at is not None:
            viewer.set_time(at[0], sequence=at[1], play_state="paused")
        if selected is not None:
            viewer.open(f"recording://{selected}")
            viewer.run_command("ui.expand_selection_panel")
        viewer.run_command("ui.toggle_top_panel")
        window = screenshot(viewer)[TOP_BAR_PX:]
    try:
        quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if picture.suffix.lower() in (".jpg", ".jpeg") else []
        complete, data = cv2.imencode(picture.suffix, window[:, :, ::-1], quality)
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
    parser.add_argument("--page", help="Summary, Pair, Why, ... or a view behind a tab (default: where it opens)")
    parser.add_argument("--time", metavar="TIMELINE=N", help="e.g. iteration=0 or frame=3 (default: where it opens)")
    parser.add_argument("--select", metavar="ENTITY", help="and tell of it, e.g. world/source/points[#7]")
    parser.add_argument("--size", default="1280x720", help="of the window, in pixels (default: %(default)s)")
    parser.add_argument("--theme", choices=THEMES, default="dark", help="(default: %(default)s)")
    args = parser.parse_args(arguments)
    try:
        save_picture(
            args.recording,
            args.picture,
            page=args.page,
            at=_parsed_time(args.time),
            selected=args.select,
            size=_parsed_size(args.size),
            theme=args.theme,
        )
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


def _parsed_size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and 320 <= int(width) <= 8192 and 240 <= int(height) <= 8192):
        raise InputError(f"--size: expected WIDTHxHEIGHT up to 8192x8192 as in 1280x720, got {text!r}")
    return int(width), int(height)


if __name__ == "__main__":
    sys.exit(main())
