"""Tensor clouds on a GPU, in the simulator: registered where they lie, with the result of the tensor API."""

import logging

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose

from adagmm_o3d import (
    TransformationEstimationForAdaptiveGMM,
    estimate_surface_covariances,
    prepare,
    registration_adaptive_gmm,
    tensor_registration,
)
from adagmm_o3d.errors import InputError
from adagmm_o3d.kernels.cuda.clouds import tensors
from adagmm_o3d.kernels.cuda.front_end import TILE, cuda
from adagmm_o3d.mixtures.device_mixture import DeviceMixture
from adagmm_o3d.pairs import cuda_pairs

# With mutuality, small clouds are refined on the device as well.
METHOD = TransformationEstimationForAdaptiveGMM(mutuality=0.5)
CRITERIA = o3d.t.pipelines.registration.ICPConvergenceCriteria(1e-6, 1e-6, 4)


@pytest.fixture(autouse=True)
def device(monkeypatch):
    """Tensors of the host count as the device's; all points at once are not to be seen on the host."""

    def refuse(self):
        raise AssertionError("all points were copied to the host")

    monkeypatch.setattr(cuda_pairs, "WANTED_BLOCKS", 1)
    monkeypatch.setattr(tensor_registration, "lies_on_gpu", lambda cloud: True)
    monkeypatch.setattr(tensors, "on_the_device", lambda tensor: cuda.to_device(tensor.numpy()))
    monkeypatch.setattr(tensors, "current_device", lambda tensor: cuda.gpus[0])
    monkeypatch.setattr(DeviceMixture, "_everything", property(refuse))


def pair(with_covariances, dtype):
    rng = np.random.default_rng(1)
    target = rng.normal(size=(3 * TILE + 1, 3)) * (1.0, 0.7, 0.4)
    T = random_pose(rng, 3, angle=0.2, distance=0.1)
    made = []
    source = (target - T[:3, 3]) @ T[:3, :3] + rng.normal(scale=3e-4, size=target.shape)
    for points in (source, target):
        tensor = o3d.t.geometry.PointCloud(o3d.core.Tensor(points, dtype))
        if with_covariances:
            tensor.point.covariances = o3d.core.Tensor(estimate_surface_covariances(points, knn=5), dtype)
        made.append(tensor)
    return *made, T


@pytest.mark.parametrize(("with_covariances", "dtype"), [(True, o3d.core.float32), (False, o3d.core.float64)])
def test_a_registration_ends_where_it_does_on_the_host(with_covariances, dtype, caplog):
    source, target, T = pair(with_covariances, dtype)
    expected = registration_adaptive_gmm(source, target, 0.1, estimation_method=METHOD, criteria=CRITERIA, device="cpu")
    lines = []
    with caplog.at_level(logging.INFO, logger="adagmm_o3d"):
        result = registration_adaptive_gmm(
            source, target, 0.1, estimation_method=METHOD, criteria=CRITERIA, callback_after_iteration=lines.append
        )
    assert caplog.records == []
    assert isinstance(result, o3d.t.pipelines.registration.RegistrationResult)
    assert (result.transformation.dtype, result.transformation.device.get_type()) == (
        expected.transformation.dtype,
        o3d.core.Device.CPU,
    )
    np.testing.assert_allclose(result.transformation.numpy(), expected.transformation.numpy(), rtol=0, atol=1e-6)
    np.testing.assert_allclose(result.transformation.numpy(), T, rtol=0, atol=1e-3)
    assert (result.fitness, result.num_iterations) == (expected.fitness, expected.num_iterations)
    assert len(lines) == result.num_iterations
    np.testing.assert_array_equal(result.correspondence_set.numpy(), expected.correspondence_set.numpy())
    ours, theirs = result.details, expected.details
    np.testing.assert_allclose(ours.row_weights, theirs.row_weights, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(ours.sigmas, theirs.sigmas, rtol=1e-5, atol=0)
    scale = np.abs(theirs.pose_covariance).max()
    np.testing.assert_allclose(ours.pose_covariance, theirs.pose_covariance, rtol=1e-3, atol=1e-4 * scale)


@pytest.mark.parametrize("options", [{"init": "global"}, {"voxel_size": 0.4}])
def test_options_work_there_as_well(options):
    source, target, _ = pair(True, o3d.core.float64)
    expected = registration_adaptive_gmm(
        source, target, 0.1, estimation_method=METHOD, criteria=CRITERIA, device="cpu", **options
    )
    result = registration_adaptive_gmm(source, target, 0.1, estimation_method=METHOD, criteria=CRITERIA, **options)
    np.testing.assert_allclose(result.transformation.numpy(), expected.transformation.numpy(), rtol=0, atol=1e-5)


@pytest.mark.parametrize("some_missing", [False, True])
@pytest.mark.parametrize("voxel_size", [-1.0, 0.4])
def test_normals_speak_there_as_well(some_missing, voxel_size):
    clouds = pair(False, o3d.core.float32)[:2]
    for k, cloud in enumerate(clouds):
        normals = np.random.default_rng(k).normal(size=(len(cloud.point.positions), 3)).astype(np.float32)
        normals[:4] *= 0.0 if some_missing else 5.0
        cloud.point.normals = o3d.core.Tensor(normals)
    options = {"estimation_method": METHOD, "criteria": CRITERIA, "voxel_size": voxel_size}
    expected = registration_adaptive_gmm(*clouds, 0.1, device="cpu", **options)
    result = registration_adaptive_gmm(*clouds, 0.1, **options)
    np.testing.assert_allclose(result.transformation.numpy(), expected.transformation.numpy(), rtol=0, atol=1e-6)


@pytest.mark.parametrize("what", ["colors", "intensity"])
def test_colours_count_there_as_well(what):
    source, target, T = pair(True, o3d.core.float64)
    places = target.point.positions.numpy()
    paint = 0.5 + 0.4 * np.sin(3.0 * places + np.arange(3))
    for cloud, darker in ((source, 0.6), (target, 1.0)):
        cloud.point[what] = o3d.core.Tensor(darker * (paint if what == "colors" else 200.0 * paint[:, :1]))
    method = TransformationEstimationForAdaptiveGMM(mutuality=0.5, color=True)
    options = {"estimation_method": method, "criteria": CRITERIA}
    expected = registration_adaptive_gmm(source, target, 0.1, device="cpu", **options)
    result = registration_adaptive_gmm(source, target, 0.1, **options)
    np.testing.assert_allclose(result.transformation.numpy(), expected.transformation.numpy(), rtol=0, atol=1e-6)
    np.testing.assert_allclose(result.transformation.numpy(), T, rtol=0, atol=1e-3)
    ours, theirs = result.details, expected.details
    np.testing.assert_allclose(ours.color.deviations, theirs.color.deviations, rtol=1e-4, atol=0)
    np.testing.assert_allclose(ours.color_support, theirs.color_support, rtol=1e-4, atol=1e-4)
    scale = np.abs(theirs.pose_covariance).max()
    np.testing.assert_allclose(ours.pose_covariance, theirs.pose_covariance, rtol=1e-3, atol=1e-4 * scale)


def test_covariances_of_the_wrong_shape_are_refused():
    source, target, _ = pair(False, o3d.core.float64)
    target.point.covariances = o3d.core.Tensor(np.ones((len(target.point.positions), 9)))
    with pytest.raises(InputError, match=r"target.covariances: expected shape \(25, 3, 3\), got \(25, 9\)"):
        registration_adaptive_gmm(source, target, 0.1)


def test_a_cloud_that_is_prepared_there():
    source, target, _ = pair(True, o3d.core.float64)
    options = {"estimation_method": METHOD, "criteria": CRITERIA}
    expected = registration_adaptive_gmm(source, target, 0.1, **options)
    ready = prepare(target)
    for _ in range(2):
        result = registration_adaptive_gmm(source, ready, 0.1, **options)
        np.testing.assert_array_equal(result.transformation.numpy(), expected.transformation.numpy())


def unequal(large, small):
    """Two clouds, half of the covariances of each times `large`, half times `small`."""
    clouds = pair(True, o3d.core.float64)[:2]
    for cloud in clouds:
        covariances = cloud.point.covariances.numpy().copy()
        covariances[: len(covariances) // 2] *= large
        covariances[len(covariances) // 2 :] *= small
        cloud.point.covariances = o3d.core.Tensor(covariances)
    return clouds


@pytest.mark.parametrize(("large", "small"), [(1e300, 1e-300), (1e200, 1e-200)])
def test_covariances_at_both_ends_of_all_numbers_are_refused(large, small):
    """In units of one another they have no number; on the host each is scaled by its own."""
    with pytest.raises(InputError, match=r"^source\.covariances: expected on a GPU variances with a number in units"):
        registration_adaptive_gmm(*unequal(large, small), 0.1, estimation_method=METHOD, criteria=CRITERIA)


def test_covariances_far_apart_end_where_they_do_on_the_host():
    clouds, options = unequal(1e100, 1e-100), {"estimation_method": METHOD, "criteria": CRITERIA}
    expected = registration_adaptive_gmm(*clouds, 0.1, device="cpu", **options)
    result = registration_adaptive_gmm(*clouds, 0.1, **options)
    np.testing.assert_allclose(result.transformation.numpy(), expected.transformation.numpy(), rtol=0, atol=1e-5)
