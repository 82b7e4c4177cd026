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


def explain(error: ImportError | OSError) -> str | None:
    """One line that says what to install; None where the error is about something else."""
    library = (getattr(error, "name", None) or "").partition(".")[0]
    if isinstance(error, ModuleNotFoundError) and library in EXTRAS:
        return f"the Python package {library} is needed and not installed; pip install 'adagmm-o3d[{_extras(library)}]'"
    if SYSTEM_LIBRARY in str(error):
        # imported late: it imports NumPy
        from adagmm_o3d.lazy_open3d import LIBRARIES

        return f"a library of the system is missing ({error}); on Debian and Ubuntu: apt-get install {LIBRARIES}"
    return None


def _extras(library: str) -> str:
    """The extra that brings a library, with the one for Open3D where that is missing too: no other brings it."""
    extra = EXTRAS[library]
    return extra if extra == "open3d" or importlib.util.find_spec("open3d") else f"{extra},open3d"
