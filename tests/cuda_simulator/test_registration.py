"""A whole registration with device="cuda", in the simulator."""

import numpy as np
import open3d as o3d
from mixtures import random_pose

from adagmm_o3d import register_points
from adagmm_o3d.kernels.cuda import pair_loop
from adagmm_o3d.kernels.cuda.front_end import TILE


def test_a_registration_ends_where_it_does_on_the_cpu(monkeypatch):
    monkeypatch.setattr(pair_loop, "WANTED_BLOCKS", 1)
    rng = np.random.default_rng(1)
    target = rng.normal(size=(3 * TILE + 1, 3)) * (1.0, 0.7, 0.4)
    T = random_pose(rng, 3, angle=0.2, distance=0.1)
    source = (target - T[:3, 3]) @ T[:3, :3]
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=4)
    results = [register_points(source, target, criteria=criteria, device=device) for device in ("cpu", "cuda")]
    poses = [result.transformation for result in results]
    np.testing.assert_allclose(poses[1], poses[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(poses[1], T, rtol=0, atol=1e-3)
    np.testing.assert_allclose(results[1].row_weights, results[0].row_weights, rtol=1e-5, atol=1e-6)
    assert results[1].iterations == results[0].iterations
