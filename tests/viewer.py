"""The real Rerun viewer without a display, for tests that look at what it shows."""

import contextlib
import ctypes.util
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import rerun_cli
from rerun.experimental import ViewerClient

VULKAN_FOLDERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")
RERUN = Path(rerun_cli.__file__).parent / "rerun"
LOADING_SECONDS = 60.0
MOST_SCREENSHOTS = 20


def vulkan_missing() -> str:
    """Why the viewer cannot run here, or nothing."""
    if ctypes.util.find_library("vulkan") is None:
        return "libvulkan1 is not installed"
    drivers = [path for folder in VULKAN_FOLDERS for path in Path(folder).glob("*.json")]
    if not drivers and not os.environ.get("VK_DRIVER_FILES") and not os.environ.get("VK_ICD_FILENAMES"):
        return "no Vulkan driver is installed (Debian: mesa-vulkan-drivers)"
    return ""


needs_viewer = pytest.mark.skipif(bool(vulkan_missing()), reason=vulkan_missing())


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def headless_viewer(path: Path) -> Iterator[ViewerClient]:
    """The viewer with a recording loaded; it is ended, with the shim that starts it, when the block ends."""
    os.environ.setdefault("RUST_LOG", "error")
    with ViewerClient.spawn(
        headless=True, port=free_port(), hide_welcome_screen=True, executable_path=str(RERUN)
    ) as viewer:
        viewer.open(str(path))
        give_up = time.monotonic() + LOADING_SECONDS
        while viewer.get_state().loading:
            assert time.monotonic() < give_up, f"{path} is still loading after {LOADING_SECONDS:g} s"
            time.sleep(0.1)
        yield viewer


def screenshot(viewer: ViewerClient, view_name: str | None = None) -> np.ndarray:
    """(H, W, 3) uint8 RGB of the window or of one view, taken again until two are equal: the first is not final."""
    view_id = None if view_name is None else view_id_of(viewer, view_name)
    before = None
    for _ in range(MOST_SCREENSHOTS):
        png = viewer.take_screenshot(view_id)
        if png == before:
            return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]
        before = png
        time.sleep(0.1)
    raise AssertionError(f"the picture still changed after {MOST_SCREENSHOTS} screenshots")


def view_id_of(viewer: ViewerClient, name: str) -> str:
    (view,) = [view for view in viewer.get_state().views if view.name == name]
    return view.view_id


def complaints(viewer: ViewerClient) -> list[str]:
    """What the views report as failed, and what the viewer logged as a warning or an error."""
    views = [f"{view.name}: {report.summary}" for view in viewer.get_state().views for report in view.reports]
    logs = [f"{entry.level}: {entry.message}" for entry in viewer.get_logs() if entry.level in ("WARN", "ERROR")]
    return views + logs
