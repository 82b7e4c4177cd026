"""Very many registrations in one process: memory stays flat.

    ADAGMM_SOAK=2000 pytest tests/plugin/test_soak.py

does so many; without it so many that 50 kB lost by each would show.
"""

import gc
import os
import resource
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy, move

from adagmm_o3d import register_points, registration_adaptive_gmm

COUNT = int(os.environ.get("ADAGMM_SOAK", "160"))
POINTS = 400
# Allocators keep what they have had; a leak grows with every registration.
ALLOWED_GROWTH_MB = 8.0

pytestmark = [
    pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="resident memory is read the Linux way"),
    pytest.mark.slow,
]


def resident_mb() -> float:
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def as_arrays(source, target):
    return register_points(source, target).transformation


def as_legacy(source, target):
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
    return registration_adaptive_gmm(*clouds, 0.1, device="cpu").transformation


def as_tensors(source, target):
    clouds = [o3d.t.geometry.PointCloud(o3d.core.Tensor(points.astype(np.float32))) for points in (source, target)]
    return registration_adaptive_gmm(*clouds, 0.1, device="cpu").transformation.numpy()


def globally(source, target):
    return register_points(source[:100], target[:100], init="global").transformation


KINDS = (as_arrays, as_legacy, as_tensors, globally)


def register(rng, kind: int) -> None:
    """One registration of clouds of this many points, more or less, in 2D every fifth time."""
    dimension = 2 if kind % 5 == 4 else 3
    n = int(rng.integers(POINTS // 4, POINTS))
    points = bumpy(rng, 2 * n, dimension)
    T = random_pose(rng, dimension, angle=0.2, distance=0.1)
    run = as_arrays if dimension == 2 else KINDS[kind % len(KINDS)]
    assert np.isfinite(run(points[:n], move(points[n:], T))).all()


def test_memory_stays_flat():
    rng = np.random.default_rng(0)
    for kind in range(60):
        register(rng, kind)
    start, seen = resident_mb(), []
    for kind in range(COUNT):
        register(rng, kind)
        if (kind + 1) % (COUNT // 8) == 0:
            seen.append(resident_mb() - start)
    print(f"resident: {start:.0f} MB, then " + " ".join(f"{mb:+.1f}" for mb in seen), f"after {COUNT} registrations")
    assert max(seen) < ALLOWED_GROWTH_MB
