"""`registration_adaptive_gmm` in place of `o3d.t.pipelines.registration.icp`: tensor clouds."""

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from test_registration import CALLBACK_KEYS, OPEN3D_KEYS, Pair, bits

from adagmm_o3d import StopReason, estimate_surface_covariances, registration_adaptive_gmm
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import pose_errors

core, treg = o3d.core, o3d.t.pipelines.registration

# The calls of Open3D's tutorial on tensor ICP, by position as there, on clouds of our own.
TUTORIAL = """
max_correspondence_distance = 0.05
init_source_to_target = o3d.core.Tensor.eye(4, o3d.core.Dtype.Float32)
estimation = treg.TransformationEstimationPointToPlane()
criteria = treg.ICPConvergenceCriteria(relative_fitness=0.000001, relative_rmse=0.000001, max_iteration=50)
voxel_size = 0.05
lines = []
callback_after_iteration = lambda loss_log_map: lines.append("Iteration Index: {}, Fitness: {}, Inlier RMSE: {}".format(
    loss_log_map["iteration_index"].item(), loss_log_map["fitness"].item(), loss_log_map["inlier_rmse"].item()))
registration_icp = treg.icp(source, target, max_correspondence_distance,
                            init_source_to_target, estimation, criteria,
                            voxel_size, callback_after_iteration)
plain = treg.icp(source, target, max_correspondence_distance)
named = treg.icp(source=source, target=target, max_correspondence_distance=max_correspondence_distance,
                 init_source_to_target=init_source_to_target, estimation_method=estimation, criteria=criteria,
                 voxel_size=voxel_size, callback_after_iteration=callback_after_iteration)
print("Inlier Fitness: ", registration_icp.fitness)
print("Inlier RMSE: ", registration_icp.inlier_rmse)
moved = source.clone().transform(registration_icp.transformation)
results = [registration_icp, plain, named]
"""


def tensor_cloud(cloud, dtype):
    tensor = o3d.t.geometry.PointCloud(core.Tensor(np.asarray(cloud.points), dtype))
    tensor.point.normals = core.Tensor(np.asarray(cloud.normals), dtype)
    return tensor


class TensorPair(Pair):
    """The pair of clouds of the legacy tests as tensors."""

    def __init__(self, dtype, **kwargs):
        super().__init__(**kwargs)
        self.source, self.target = tensor_cloud(self.source, dtype), tensor_cloud(self.target, dtype)


@pytest.fixture(scope="module", params=[core.float32, core.float64], ids=["float32", "float64"])
def pair(request):
    return TensorPair(request.param)


def test_a_tutorial_script_needs_only_the_functions_name_swapped(pair):
    names = {"o3d": o3d, "treg": treg, "registration_adaptive_gmm": registration_adaptive_gmm}
    names |= {"source": pair.source, "target": pair.target}
    exec(TUTORIAL, dict(names))
    exec(TUTORIAL.replace("treg.icp(", "registration_adaptive_gmm("), names)
    assert len(names["lines"]) > 1
    for result in names["results"]:
        assert isinstance(result, treg.RegistrationResult)
        errors = pose_errors(pair.T, result.transformation.numpy())
        assert errors.rotation_deg < 2.0 and errors.translation < 0.02


def test_a_distance_as_large_as_the_cloud_makes_no_pairs_of_all_points(pair, monkeypatch):
    """Open3D's own count looks at every pair within the distance."""
    expected = treg.evaluate_registration(pair.source, pair.target, 10.0, core.Tensor(pair.T))

    def never(*_):
        raise AssertionError("all pairs were looked at")

    monkeypatch.setattr(treg, "evaluate_registration", never)
    result = registration_adaptive_gmm(pair.source, pair.target, 10.0)
    assert result.fitness == expected.fitness == 1.0
    assert result.correspondence_set.shape == expected.correspondence_set.shape


def test_the_result_is_open3ds_and_counts_as_open3d_does(pair):
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05)
    theirs = treg.icp(pair.source, pair.target, 0.05)
    expected = treg.evaluate_registration(pair.source, pair.target, 0.05, result.transformation)
    assert isinstance(result, treg.RegistrationResult)
    assert (result.transformation.dtype, result.transformation.device) == (core.float64, core.Device("CPU:0"))
    assert (result.transformation.dtype, result.transformation.device) == (
        theirs.transformation.dtype,
        theirs.transformation.device,
    )
    assert result.fitness == expected.fitness
    # Open3D adds up in the points' own type, and its threads in no fixed order.
    rounding = 1e-12 if pair.source.point.positions.dtype == core.float64 else 1e-6
    np.testing.assert_allclose(result.inlier_rmse, expected.inlier_rmse, rtol=rounding, atol=0)
    np.testing.assert_array_equal(result.correspondence_set.numpy(), expected.correspondence_set.numpy())
    assert result.converged is True and result.num_iterations == result.details.iterations > 0
    errors = pose_errors(pair.T, result.transformation.numpy())
    assert errors.rotation_deg < 1.0 and errors.translation < 0.01


@pytest.mark.parametrize("most", [1, 2, 3])
def test_too_few_iterations_do_not_converge(pair, most):
    bare = [o3d.t.geometry.PointCloud(cloud.point.positions) for cloud in (pair.source, pair.target)]
    criteria, seen = treg.ICPConvergenceCriteria(1e-6, 1e-6, most), []
    result = registration_adaptive_gmm(*bare, 0.05, criteria=criteria, callback_after_iteration=seen.append)
    assert result.converged is False and not result.details.trustworthy
    assert result.num_iterations == result.details.iterations == len(seen) == most
    errors = pose_errors(pair.T, result.transformation.numpy())
    assert errors.rotation_deg < 3.0 and errors.translation < 0.04


@pytest.mark.parametrize("init", [None, "given"])
def test_no_iterations_give_the_start_evaluated(pair, init):
    start = np.eye(4) if init is None else np.round(pair.T, 3)
    criteria, seen = treg.ICPConvergenceCriteria(1e-6, 1e-6, 0), []
    arguments = (pair.source, pair.target, 0.05, None if init is None else core.Tensor(start))
    result = registration_adaptive_gmm(*arguments, criteria=criteria, callback_after_iteration=seen.append)
    theirs = treg.icp(pair.source, pair.target, 0.05, core.Tensor(start), criteria=criteria)
    np.testing.assert_array_equal(result.transformation.numpy(), theirs.transformation.numpy())
    np.testing.assert_array_equal(result.transformation.numpy(), start)
    assert (result.fitness, result.num_iterations, result.converged) == (theirs.fitness, 0, False)
    details = result.details
    assert (details.iterations, len(seen), details.stop_reason) == (0, 0, StopReason.MAX_ITERATION)
    assert details.transformations.shape == (1, 4, 4) and not details.trustworthy
    assert details.overlap > 0.9 if init else details.overlap < 0.9


def test_without_a_limit_every_point_counts(pair):
    result = registration_adaptive_gmm(pair.source, pair.target, np.inf)
    # what Open3D answers to a distance that no two points have
    expected = treg.evaluate_registration(pair.source, pair.target, 10.0, result.transformation)
    assert result.fitness == expected.fitness == 1.0
    np.testing.assert_allclose(result.inlier_rmse, expected.inlier_rmse, rtol=1e-5, atol=0)
    np.testing.assert_array_equal(result.correspondence_set.numpy(), expected.correspondence_set.numpy())
    assert result.correspondence_set.dtype == expected.correspondence_set.dtype


def test_tensor_and_legacy_clouds_agree_bit_by_bit():
    legacy, tensor = Pair(), TensorPair(core.float64)
    expected = registration_adaptive_gmm(legacy.source, legacy.target, 0.05)
    assert bits(registration_adaptive_gmm(tensor.source, tensor.target, 0.05)) == bits(expected)


def test_float32_and_float64_clouds_agree():
    poses = [
        registration_adaptive_gmm(p.source, p.target, 0.05).transformation.numpy()
        for p in (TensorPair(core.float32), TensorPair(core.float64))
    ]
    np.testing.assert_allclose(poses[0], poses[1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("as_tensor", [True, False])
@pytest.mark.parametrize("keyword", ["init", "init_source_to_target"])
def test_init_is_where_it_starts(pair, as_tensor, keyword):
    init = random_pose(np.random.default_rng(3), 3, angle=0.05, distance=0.02) @ pair.T
    value = core.Tensor(init, core.float64) if as_tensor else init
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, **{keyword: value})
    np.testing.assert_allclose(result.details.transformations[0], init, rtol=0, atol=1e-6)


def test_covariances_are_the_clouds_own_and_thinned_with_it(pair):
    def run(factor, voxel_size):
        clouds = []
        for cloud in (pair.source, pair.target):
            covariances = estimate_surface_covariances(cloud.point.positions.numpy().astype(float))
            clouds.append(cloud.clone())
            clouds[-1].point.covariances = core.Tensor(factor * covariances, cloud.point.positions.dtype)
        return registration_adaptive_gmm(*clouds, 0.05, voxel_size=voxel_size)

    bare = [o3d.t.geometry.PointCloud(cloud.point.positions) for cloud in (pair.source, pair.target)]
    without = registration_adaptive_gmm(*bare, 0.05)
    np.testing.assert_allclose(run(1.0, -1.0).transformation.numpy(), without.transformation.numpy(), rtol=0, atol=1e-5)
    np.testing.assert_allclose(run(2e-4, -1.0).details.sigma, run(1.0, -1.0).details.sigma / 2e-4, rtol=1e-3, atol=0)
    thinned = run(1.0, 0.2)
    assert len(thinned.details.row_weights) == len(pair.source.voxel_down_sample(0.2).point.positions) < 300
    errors = pose_errors(pair.T, thinned.transformation.numpy())
    assert errors.rotation_deg < 3.0 and errors.translation < 0.03


def test_voxel_averages_of_covariances_are_averages():
    # Two points share a voxel, each of the others has one of its own.
    points = np.array([[0.0, 0, 0], [0.1, 0.1, 0], [5.0, 0, 0], [0, 5.0, 0], [0, 0, 5.0]])
    covariances = np.arange(1.0, 6.0)[:, None, None] * np.eye(3)
    halved = np.array([1.5, 3.0, 4.0, 5.0])[:, None, None] * np.eye(3)
    means = np.array([[0.05, 0.05, 0], *points[2:]])
    clouds = []
    for p, c in ((points, covariances), (means, halved)):
        clouds.append(o3d.t.geometry.PointCloud(core.Tensor(p)))
        clouds[-1].point.covariances = core.Tensor(c)
    thinned = registration_adaptive_gmm(clouds[0], clouds[1], 1.0, voxel_size=1.0)
    whole = registration_adaptive_gmm(clouds[1], clouds[1], 1.0)
    np.testing.assert_allclose(thinned.transformation.numpy(), np.eye(4), rtol=0, atol=1e-4)
    np.testing.assert_allclose(thinned.details.sigma, whole.details.sigma, rtol=1e-6, atol=0)


def test_the_clouds_are_not_modified(pair):
    def state(cloud):
        return {key: cloud.point[key].numpy().tobytes() for key in cloud.point}

    before = state(pair.source), state(pair.target)
    registration_adaptive_gmm(pair.source, pair.target, 0.05, voxel_size=0.05)
    registration_adaptive_gmm(pair.source, pair.target, 0.05)
    assert (state(pair.source), state(pair.target)) == before


def test_the_callback_gets_what_open3ds_gets_and_more(pair):
    ours, theirs = [], []
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, callback_after_iteration=ours.append)
    treg.icp(pair.source, pair.target, 0.05, callback_after_iteration=theirs.append)
    assert set(ours[0]) == CALLBACK_KEYS and set(theirs[0]) == OPEN3D_KEYS
    for key in OPEN3D_KEYS:
        a, b = ours[0][key], theirs[0][key]
        assert (a.dtype, a.device, tuple(a.shape)) == (b.dtype, b.device, tuple(b.shape))
    assert [s["iteration_index"].item() for s in ours] == list(range(result.num_iterations))
    np.testing.assert_array_equal(ours[-1]["transformation"].numpy(), result.transformation.numpy())


class Elsewhere(o3d.t.geometry.PointCloud):
    """A cloud that says it is on a GPU; what else is in it is real."""

    @property
    def device(self):
        return o3d.core.Device("CUDA:0")


@pytest.mark.parametrize("moved", ["source", "target"])
def test_clouds_on_different_devices_are_refused_and_both_named(moved):
    points = o3d.core.Tensor(np.random.default_rng(0).normal(size=(20, 3)))
    kinds = (Elsewhere, o3d.t.geometry.PointCloud)
    source, target = (kind(points) for kind in (kinds if moved == "source" else kinds[::-1]))
    with pytest.raises(InputError) as caught:
        registration_adaptive_gmm(source, target, 0.1)
    here, there = ("CUDA:0", "CPU:0") if moved == "source" else ("CPU:0", "CUDA:0")
    assert str(caught.value) == f"target: expected on the device of source, {here}, got {there}; move one with .to()"
