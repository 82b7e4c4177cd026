"""The CUDA kernels on a GPU: what the simulator cannot see (races, rounding, real blocks), and whole registrations."""

import numpy as np
import open3d as o3d
import pytest

from adagmm_o3d.kernels.cuda.availability import obstacle, simulated
from adagmm_o3d.mixtures.device_mixture import DeviceMixture

if simulated() or (reason := obstacle()) is not None:
    pytest.skip("this is the simulator" if simulated() else reason, allow_module_level=True)

import cuda_cases
from cuda_cases import Case
from mixtures import random_pose

from adagmm_bench.gpu.checks import run_checks
from adagmm_o3d import register_points, registration_adaptive_gmm
from adagmm_o3d.kernels.cuda.front_end import TILE

SHAPES = [("2D", 2, True), ("2D anisotropic", 2, False), ("3D", 3, True), ("3D anisotropic", 3, False)]
shapes = pytest.mark.parametrize(("dimension", "isotropic"), [s[1:] for s in SHAPES], ids=[s[0] for s in SHAPES])
SIZES = [(3, TILE - 1), (TILE, TILE), (TILE + 1, 2 * TILE + 1), (2 * TILE - 1, 700), (300, 65 * TILE)]
sizes = pytest.mark.parametrize(("m", "n"), SIZES)


@shapes
@sizes
def test_sums_match_the_naive_reference(dimension, isotropic, m, n):
    cuda_cases.check_sums(Case(7 * m + n, m, n, dimension, isotropic))


@shapes
@sizes
@pytest.mark.parametrize("mutuality", [0.0, 0.5])
def test_posterior_sums_match_the_naive_reference(dimension, isotropic, m, n, mutuality):
    cuda_cases.check_posterior_sums(Case(11 * m + n, m, n, dimension, isotropic), mutuality)


@shapes
@sizes
def test_nearest_distances_match_the_naive_reference(dimension, isotropic, m, n):
    cuda_cases.check_nearest(Case(m + n, m, n, dimension, isotropic))


@shapes
@pytest.mark.parametrize(("m", "n"), [(1000, 1300), (6000, 5000)])
def test_the_cpu_gives_the_same_sums(dimension, isotropic, m, n):
    cuda_cases.check_against_the_cpu(Case(m, m, n, dimension, isotropic))


def test_the_bits_are_the_same_every_time():
    case = Case(5, 3000, 4000, 3, isotropic=False)
    assert len({cuda_cases.bits(case) for _ in range(5)}) == 1


def test_every_check_of_the_bench_passes():
    assert [check for check in run_checks(seed=9) if not check.passed] == []


@pytest.mark.skipif(not o3d.core.cuda.is_available(), reason="this Open3D knows no CUDA")
@pytest.mark.parametrize("dtype", [o3d.core.float32, o3d.core.float64], ids=["float32", "float64"])
def test_tensor_clouds_on_the_gpu_are_registered_there(dtype, monkeypatch):

    def refuse(self):
        raise AssertionError("all points were copied to the host")

    monkeypatch.setattr(DeviceMixture, "_everything", property(refuse))
    rng = np.random.default_rng(2)
    target = rng.normal(size=(5000, 3)) * (1.0, 0.7, 0.4)
    T = random_pose(rng, 3, angle=0.2, distance=0.1)
    source = (target - T[:3, 3]) @ T[:3, :3] + 0.003 * rng.normal(size=target.shape)
    clouds = [o3d.t.geometry.PointCloud(o3d.core.Tensor(points, dtype)) for points in (source, target)]
    expected = registration_adaptive_gmm(*clouds, 0.05, device="cpu")
    result = registration_adaptive_gmm(*(c.cuda() for c in clouds), 0.05)
    assert result.correspondence_set.device == o3d.core.Device("CUDA:0")
    assert result.transformation.device == expected.transformation.device
    np.testing.assert_allclose(result.transformation.numpy(), expected.transformation.numpy(), rtol=0, atol=1e-4)
    np.testing.assert_allclose(result.fitness, expected.fitness, rtol=1e-3, atol=0)


@pytest.mark.parametrize("rule", ["posterior", "nearest"])
def test_a_registration_ends_where_it_does_on_the_cpu(rule):
    from adagmm_o3d import TransformationEstimationForAdaptiveGMM

    rng = np.random.default_rng(1)
    target = rng.normal(size=(3000, 3)) * (1.0, 0.7, 0.4)
    T = random_pose(rng, 3, angle=0.2, distance=0.1)
    source = (target - T[:3, 3]) @ T[:3, :3] + 0.003 * rng.normal(size=target.shape)
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule)
    poses = [
        register_points(source, target, estimation_method=method, device=d).transformation for d in ("cpu", "cuda")
    ]
    np.testing.assert_allclose(poses[1], poses[0], rtol=0, atol=1e-4)
    np.testing.assert_allclose(poses[1], T, rtol=0, atol=3e-3)
