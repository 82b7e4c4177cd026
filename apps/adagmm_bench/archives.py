"""Arrays in .npz files from outside."""

from __future__ import annotations

import zipfile
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np

from adagmm_fusion.files.input_file import read_input
from adagmm_o3d.errors import InputError


def read_archive(path: Path, wanted: str, names: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
    """The arrays of a file, all or those of some names; nothing is unpickled.

    wanted : what the file should be, for the error.

    Raises
    ------
    InputError  if the file cannot be read, is no such archive, or lacks a name.
    """
    content = read_input(path, InputError, missing=f"expected {wanted}, there is no such file")
    try:
        with np.load(BytesIO(content), allow_pickle=False) as archive:
            return {name: archive[name] for name in (archive.files if names is None else names)}
    # TypeError: a single array, which np.load returns as it is.
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: expected {wanted}, got {' '.join(str(error).split())}") from error


def numbers(path: Path, name: str, array: np.ndarray) -> np.ndarray:
    """An array of a file as float64. Raises InputError if it holds something other than numbers."""
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: {name}: expected numbers, got {array.dtype}")
    return array.astype(float)
