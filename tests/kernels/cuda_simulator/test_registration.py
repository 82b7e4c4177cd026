"""A whole registration with device="cuda", in the simulator."""

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose

from adagmm_o3d import TransformationEstimationForAdaptiveGMM, register_points
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.kernels.cuda.front_end import TILE
from adagmm_o3d.pairs import cuda_pairs
from adagmm_o3d.pairs import device as devices


def test_what_is_no_cloud_is_refused_with_the_same_words():
    cloud = np.random.default_rng(0).normal(size=(9, 3))
    covariances = np.broadcast_to(np.eye(3), (9, 3, 3))
    wrong = [(3.0, None), (cloud[:, 0], None), ([[0.0, 1.0], [2.0]], None), (cloud.astype(str), None)]
    wrong += [(cloud, covariances[:8]), (cloud, covariances[:, :2]), (cloud[:, :2], None), (cloud[:0], None)]
    for points, given in wrong:
        errors = []
        for device in ("cpu", "cuda"):
            with pytest.raises(AdaGMMError) as caught:
                register_points(points, cloud, given, device=device)
            errors.append((type(caught.value), str(caught.value)))
        assert errors[0] == errors[1]


def test_auto_prepares_clouds_where_their_pairs_will_be(monkeypatch):
    cloud = np.random.default_rng(0).normal(size=(9, 3))
    monkeypatch.setattr(devices, "CROSSING_PAIRS", 9 * 9)

    def on_device(device, points):
        return devices.mixture_maker(device, points, points)("source", points, None).on_device

    assert on_device("auto", cloud) and on_device("cuda", cloud[:8])
    assert not on_device("auto", cloud[:8]) and not on_device("cpu", cloud)
    assert not on_device("cuda", cloud[:, :2])  # in the plane the host prepares


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_registration_ends_where_it_does_on_the_cpu(dimension, monkeypatch):
    monkeypatch.setattr(cuda_pairs, "WANTED_BLOCKS", 1)
    rng = np.random.default_rng(1)
    target = rng.normal(size=(3 * TILE + 1, dimension)) * (1.0, 0.7, 0.4)[:dimension]
    T = random_pose(rng, dimension, angle=0.2, distance=0.1)
    source = (target - T[:-1, -1]) @ T[:-1, :-1]
    criteria = o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=4)
    # with mutuality, small clouds are refined on the device as well
    method = TransformationEstimationForAdaptiveGMM(mutuality=0.5)
    results = [
        register_points(source, target, estimation_method=method, criteria=criteria, device=device)
        for device in ("cpu", "cuda")
    ]
    poses = [result.transformation for result in results]
    np.testing.assert_allclose(poses[1], poses[0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(poses[1], T, rtol=0, atol=1e-3)
    np.testing.assert_allclose(results[1].row_weights, results[0].row_weights, rtol=1e-5, atol=1e-6)
    assert results[1].iterations == results[0].iterations
