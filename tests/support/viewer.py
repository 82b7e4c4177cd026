"""The real Rerun viewer without a display, for tests that look at what it shows."""

import ctypes.util
import os
from pathlib import Path

import numpy as np
import pytest
from rerun.experimental import ViewerClient

from adagmm_fusion.rerun_log import picture

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


def screenshot(viewer: ViewerClient, view_name: str | None = None) -> np.ndarray:
    """(H, W, 3) uint8 RGB of the window, or of the view of that name."""
    return picture.screenshot(viewer, None if view_name is None else view_id_of(viewer, view_name))


def view_id_of(viewer: ViewerClient, name: str) -> str:
    (view,) = [view for view in viewer.get_state().views if view.name == name]
    return view.view_id


def complaints(viewer: ViewerClient) -> list[str]:
    """What the views report as failed, and what the viewer logged as a warning or an error."""
    views = [f"{view.name}: {report.summary}" for view in viewer.get_state().views for report in view.reports]
    logs = [f"{entry.level}: {entry.message}" for entry in viewer.get_logs() if entry.level in ("WARN", "ERROR")]
    return views + logs
