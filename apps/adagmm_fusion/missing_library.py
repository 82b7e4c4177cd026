"""What is missing where a command cannot import a library: which extra brings it, or which packages of the system."""

import importlib.util

EXTRAS = {
    "cv2": "apps",
    "rerun": "apps",
    "rich": "apps",
    "rosbags": "apps",
    "scipy": "apps",
    "shtab": "apps",
    "yaml": "apps",
    "open3d": "open3d",
    "matplotlib": "bench",
    "dask": "distributed",
    "distributed": "distributed",
}
SYSTEM_LIBRARY = "cannot open shared object file"


def explain(error: ImportError | OSError, own_extra: str = "apps") -> str | None:
    """One line that says what to install; None where the error is about something else.

    own_extra : the one that brings what the command cannot do without.
    """
    library = (getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and library in EXTRAS:
        extras = _extras(library, own_extra)
        return f"the Python package {library} is needed and not installed; pip install 'adagmm-o3d[{extras}]'"
    if SYSTEM_LIBRARY in str(error):
        # imported late: it imports NumPy
        from adagmm_o3d.lazy_open3d import LIBRARIES

        return f"a library of the system is missing ({error}); on Debian and Ubuntu: apt-get install {LIBRARIES}"
    return None


def _extras(library: str, own_extra: str) -> str:
    """The extra that brings a library, and others that are missing too: that for Open3D is part of no other."""
    extras = {EXTRAS[library]} - {"apps"}
    if EXTRAS[library] == "apps" or not _is_installed("rich"):
        extras.add(own_extra)
    if not _is_installed("open3d"):
        extras.add("open3d")
    return ",".join(sorted(extras))


def _is_installed(library: str) -> bool:
    try:
        return importlib.util.find_spec(library) is not None
    except (ImportError, ValueError):
        return False
