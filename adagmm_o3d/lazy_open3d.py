"""Open3D, imported when something of it is first asked for: it takes a second, and arrays are registered without it."""

from __future__ import annotations

import importlib
import importlib.util
from functools import cache
from typing import TYPE_CHECKING, Any

from adagmm_o3d.errors import MissingLibraryError

if TYPE_CHECKING:
    import open3d as o3d
else:

    class _Open3D:
        """Stands for the module `open3d`."""

        def __getattr__(self, name: str) -> Any:
            return getattr(_imported(), name)

    o3d = _Open3D()

__all__ = ["is_installed", "o3d"]

INSTALL = "pip install 'adagmm-o3d[open3d]', or 'adagmm-o3d[open3d-cpu]'"
# What Open3D's wheel links against on Debian and Ubuntu.
LIBRARIES = "libgl1 libegl1 libgomp1 libusb-1.0-0 libx11-6 libidn2-0"


def is_installed() -> bool:
    """Whether Open3D can be found; it may still fail to load."""
    try:
        return importlib.util.find_spec("open3d") is not None
    except ValueError:  # another module of that name has been put in its place
        return True


@cache
def _imported() -> Any:
    """The module.

    Raises
    ------
    MissingLibraryError : it is not installed, or a library of the system that it links against is missing.
    """
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        if error.name != "open3d":
            raise
        raise MissingLibraryError(f"open3d: expected to be installed, found nothing; {INSTALL}") from None
    except (ImportError, OSError) as error:
        reason = " ".join(str(error).split())
        raise MissingLibraryError(
            f"open3d: cannot be loaded ({reason}); on Debian and Ubuntu: apt-get install {LIBRARIES}"
        ) from error
