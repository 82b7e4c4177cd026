"""Where the public recordings and clouds used by some tests lie, and how a test skips without them."""

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def shared_data(*parts: str) -> Path:
    """The path of a shared data file or folder; skips the calling test, saying why, where it is absent."""
    base = Path(os.environ.get("ADAGMM_SHARED_DATA", ROOT.parent / "shared" / "data"))
    path = base.joinpath(*parts)
    if not path.exists():
        pytest.skip(f"{'/'.join(parts)} is not there; set ADAGMM_SHARED_DATA to the folder that holds it")
    return path
