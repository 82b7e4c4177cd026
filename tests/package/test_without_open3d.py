"""NumPy and Numba are enough to register arrays; what needs Open3D says so."""

import subprocess
import sys

import pytest

BLOCKED = """
import sys
import numpy as np

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"open3d", "scipy"}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocked())
import importlib.util
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name == "open3d" else find(name, package)
import adagmm_o3d
"""

ARRAYS = """
from adagmm_o3d import Criteria, estimate_surface_covariances, register_points
from adagmm_o3d.evaluation import overlap_ratio

rng = np.random.default_rng(3)
points = rng.normal(size=(400, 3)) * (1.0, 0.7, 0.4)
points /= np.linalg.norm(points / (1.0, 0.7, 0.4), axis=1, keepdims=True)
moved = points @ np.array([[0.96, -0.28, 0.0], [0.28, 0.96, 0.0], [0.0, 0.0, 1.0]]) + 0.1
covariances = estimate_surface_covariances(moved), estimate_surface_covariances(points)
result = register_points(moved, points, *covariances, criteria=Criteria(relative_rmse=1e-6, max_iteration=300))
assert result.trustworthy, result.warnings
assert result.pose_covariance.shape == (6, 6)
aligned = moved @ result.transformation[:3, :3].T + result.transformation[:3, 3]
np.testing.assert_allclose(aligned, points, rtol=0, atol=1e-3)
assert overlap_ratio(moved, points, result.transformation, 0.01) == 1.0
assert "open3d" not in sys.modules
"""

CLOUDS = """
try:
    adagmm_o3d.registration_adaptive_gmm(None, None, 0.1)
except adagmm_o3d.MissingLibraryError as error:
    assert isinstance(error, ImportError)
    print(error)
"""


def run(code):
    return subprocess.run([sys.executable, "-c", BLOCKED + code], capture_output=True, text=True)


@pytest.mark.slow
def test_arrays_are_registered():
    done = run(ARRAYS)
    assert done.returncode == 0, done.stderr


def test_clouds_need_it_and_one_line_says_how_to_get_it():
    done = run(CLOUDS)
    assert done.returncode == 0, done.stderr
    assert done.stdout == (
        "open3d: expected to be installed, found nothing; "
        "pip install 'adagmm-o3d[open3d]', or 'adagmm-o3d[open3d-cpu]'\n"
    )


def test_importing_the_package_imports_neither_open3d_nor_numba():
    code = "import sys, adagmm_o3d; print(sorted({'open3d', 'numba', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
