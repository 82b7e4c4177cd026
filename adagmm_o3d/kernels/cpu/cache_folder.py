"""Where compiled kernels are kept on machines where Numba finds no place for them, as in containers, read-only images.

Numba keeps them beside the source, or else in the user's home, and raises where it may write to neither. Here a
folder for temporary files comes after these two, for this package's kernels alone. Kernels that were compiled beside
the source ahead, by `python -m adagmm_o3d.warm_up`, are used though nobody may write there any more: they are copied,
as Numba reads and writes in one folder.
"""

import atexit
import logging
import os
import shutil
import stat
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import caching

PACKAGE = Path(__file__).resolve().parents[2]

_log = logging.getLogger("adagmm_o3d")


# Named with or without an underscore, as Numba's version has it.
_UserWideCacheLocator: Any = next(
    entry
    for entry in caching.FunctionCache._impl_class._locator_classes
    if entry.__name__.lstrip("_") == "UserWideCacheLocator"
)


class FallbackLocator(_UserWideCacheLocator):
    """One of Numba's locators: the user's cache folder, or a temporary one where that cannot be written."""

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Any:
        """A locator for a kernel of this package, or None: for others' functions, and where nothing can be written."""
        source = Path(py_file).resolve()
        if PACKAGE not in source.parents:
            return None
        locator = super().from_function(py_func, py_file)
        if locator is None:
            folder = temporary_folder()
            if folder is None:
                return None
            locator = cls(py_func, py_file)
            locator._cache_path = str(folder / cls.get_suitable_cache_subpath(py_file))
            try:
                locator.ensure_cache_path()
            except OSError:
                return None
        _copy_kernels(source, Path(locator.get_cache_path()))
        return locator


def find_a_folder(function_cache: Any) -> bool:
    """Let a `FunctionCache` of Numba's look here too; returns whether kernels can be kept anywhere."""
    classes = function_cache._impl_class._locator_classes
    if FallbackLocator not in classes:
        # before the user's own folder, so that kernels compiled ahead are found for users who have one
        names = [entry.__name__.lstrip("_") for entry in classes]
        classes.insert(names.index("UserWideCacheLocator"), FallbackLocator)
    try:
        function_cache(find_a_folder)
    except RuntimeError:
        _log.warning("no folder for compiled kernels can be written, each process compiles them: set NUMBA_CACHE_DIR")
        return False
    return True


@cache
def temporary_folder() -> Path | None:
    """A folder that nobody else may write to, and that the user's next process finds again if it can; said once."""
    try:
        folder = Path(tempfile.gettempdir()) / f"adagmm_o3d-kernels-{_user()}"
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        if not _is_ours(folder):
            folder = Path(tempfile.mkdtemp(prefix="adagmm_o3d-kernels-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
    except OSError:
        return None
    _log.warning("compiled kernels are kept in %s, as Numba's cache cannot be written: see NUMBA_CACHE_DIR", folder)
    return folder


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"


def _is_ours(folder: Path) -> bool:
    """Whether only this user may write there: code is loaded from it."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        return False
    return not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o077)


def _copy_kernels(source: Path, folder: Path) -> None:
    """Copy what was compiled beside a source file, unless a copy as new is there; the indices last: they name the rest.

    A copy that cannot be made is done without.
    """
    names = f"{source.stem}.*.nb"
    with suppress(OSError):
        for kind in ("c", "i"):
            for kernel in (source.parent / "__pycache__").glob(names + kind):
                copy = folder / kernel.name
                if copy.exists() and copy.stat().st_mtime >= kernel.stat().st_mtime:
                    continue
                unfinished = folder / f"{kernel.name}.tmp.{os.getpid()}"
                shutil.copy2(kernel, unfinished)
                unfinished.replace(copy)
