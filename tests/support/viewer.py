"""The real Rerun viewer without a display, for tests that look at what it shows."""

import ctypes.util
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest
from rerun.experimental import ViewerClient

from adagmm_fusion.rerun_log import picture

T = TypeVar("T")
PATIENCE_SECONDS = 120.0
VULKAN_FOLDERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")


def vulkan_missing() -> str:
    """Why the viewer cannot run here, or nothing."""
    if ctypes.util.find_library("vulkan") is None:
        return "libvulkan1 is not installed"
    drivers = [path for folder in VULKAN_FOLDERS for path in Path(folder).glob("*.json")]
    if not drivers and not os.environ.get("VK_DRIVER_FILES") and not os.environ.get("VK_ICD_FILENAMES"):
        return "no Vulkan driver is installed (Debian: mesa-vulkan-drivers)"
    return ""


needs_viewer = pytest.mark.skipif(bool(vulkan_missing()), reason=vulkan_missing())


def eventually(look: Callable[[], T], *, seconds: float = PATIENCE_SECONDS, pause: float = 0.1) -> T:
    """What `look` returns once none of its assertions fails; the viewer shows what it was told when it gets to it.

    Raises
    ------
    AssertionError  the last one, if they still fail after `seconds`; between two looks it waits for `pause` seconds.
    """
    give_up = time.monotonic() + seconds
    while True:
        try:
            return look()
        except AssertionError:
            if time.monotonic() > give_up:
                raise
        time.sleep(pause)


def screenshot(viewer: ViewerClient, view_name: str | None = None) -> np.ndarray:
    """(H, W, 3) uint8 RGB of the window, or of the view of that name, once it is there and has come to rest."""
    view_id = None if view_name is None else eventually(lambda: view_id_of(viewer, view_name))
    return picture.screenshot(viewer, view_id)


def view_id_of(viewer: ViewerClient, name: str) -> str:
    found = [view.view_id for view in viewer.get_state().views if view.name == name]
    assert len(found) == 1, f"{len(found)} views are called {name!r}"
    return found[0]


def complaints(viewer: ViewerClient) -> list[str]:
    """What the views report as failed, and what the viewer logged as a warning or an error."""
    views = [f"{view.name}: {report.summary}" for view in viewer.get_state().views for report in view.reports]
    logs = [f"{entry.level}: {entry.message}" for entry in viewer.get_logs() if entry.level in ("WARN", "ERROR")]
    return views + logs
