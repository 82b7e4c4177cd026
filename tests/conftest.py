"""Shared by all tests: a calm OpenMP, and the tests' own helpers importable by name."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_WAIT_POLICY", "passive")
sys.path.insert(0, str(Path(__file__).parent))
