"""Shared by all tests: a calm OpenMP, repeatable properties, and the tests' own helpers importable by name."""

import os
import sys
from pathlib import Path

from hypothesis import settings

os.environ.setdefault("OMP_WAIT_POLICY", "passive")
sys.path.insert(0, str(Path(__file__).parent))

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")
