"""`registration_adaptive_gmm` in place of Open3D's ICP and GICP: legacy clouds."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy_ellipsoid, move

from adagmm_o3d import (
    DegenerateError,
    PointRegistrationResult,
    TransformationEstimationForAdaptiveGMM,
    estimate_surface_covariances,
    registration_adaptive_gmm,
)
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.options import _say_what_stands_for

reg = o3d.pipelines.registration

OPEN3D_KEYS = {"iteration_index", "scale_index", "scale_iteration_index", "inlier_rmse", "fitness", "transformation"}
CALLBACK_KEYS = OPEN3D_KEYS | {"sigma", "energy"}

# What a user has who followed Open3D's ICP tutorial: the calls of that page, on clouds of our own.
TUTORIAL = """
threshold = 0.05
trans_init = np.asarray([[0.995, -0.0998, 0.0, 0.05], [0.0998, 0.995, 0.0, -0.02], [0.0, 0.0, 1.0, 0.02], [0, 0, 0, 1]])
evaluation = o3d.pipelines.registration.evaluate_registration(source, target, threshold, trans_init)
print("Initial alignment", evaluation)

p2p = o3d.pipelines.registration.registration_icp(
    source, target, threshold, trans_init, o3d.pipelines.registration.TransformationEstimationPointToPoint()
)
print("Point-to-point", p2p)
print("Transformation is:", p2p.transformation)
longer = o3d.pipelines.registration.registration_icp(
    source, target, threshold, trans_init,
    o3d.pipelines.registration.TransformationEstimationPointToPoint(),
    o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=2000),
)
p2l = o3d.pipelines.registration.registration_icp(
    source, target, threshold, trans_init, o3d.pipelines.registration.TransformationEstimationPointToPlane()
)
loss = o3d.pipelines.registration.TukeyLoss(k=0.1)
robust = o3d.pipelines.registration.registration_icp(
    source, target, threshold, trans_init, o3d.pipelines.registration.TransformationEstimationPointToPlane(loss)
)
gicp = o3d.pipelines.registration.registration_generalized_icp(
    source, target, threshold, trans_init,
    o3d.pipelines.registration.TransformationEstimationForGeneralizedICP(),
    o3d.pipelines.registration.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=50),
)
named = o3d.pipelines.registration.registration_icp(
    source=source, target=target, max_correspondence_distance=threshold, init=trans_init,
    estimation_method=o3d.pipelines.registration.TransformationEstimationPointToPoint(),
    criteria=o3d.pipelines.registration.ICPConvergenceCriteria(),
)
bare = o3d.pipelines.registration.registration_icp(source, target, threshold)
information = o3d.pipelines.registration.get_information_matrix_from_point_clouds(
    source, target, threshold, gicp.transformation
)
graph = o3d.pipelines.registration.PoseGraph()
graph.edges.append(o3d.pipelines.registration.PoseGraphEdge(0, 1, gicp.transformation, information, uncertain=False))
moved = o3d.geometry.PointCloud(source).transform(p2p.transformation)
matched = np.asarray(p2p.correspondence_set)
closest = np.asarray(moved.points)[matched[:, 0]] - np.asarray(target.points)[matched[:, 1]]
results = [p2p, longer, p2l, robust, gicp, named, bare]
"""
SWAPPED = TUTORIAL.replace("o3d.pipelines.registration.registration_icp(", "registration_adaptive_gmm(").replace(
    "o3d.pipelines.registration.registration_generalized_icp(", "registration_adaptive_gmm("
)


def legacy_cloud(points, normals=None, covariances=None):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(normals)
    if covariances is not None:
        cloud.covariances = o3d.utility.Matrix3dVector(covariances)
    return cloud


class Pair:
    """Two samplings of one surface, some millimetres of noise, 20 degrees apart."""

    def __init__(self, seed=0, n=500, noise=0.003):
        rng = np.random.default_rng(seed)
        self.T = random_pose(rng, 3, angle=np.radians(20.0), distance=0.15)
        points, normals = bumpy_ellipsoid(rng, 2 * n)
        noisy = points + noise * rng.normal(size=points.shape)
        self.source = legacy_cloud(noisy[:n], normals[:n])
        self.target = legacy_cloud(move(noisy[n:], self.T), normals[n:] @ self.T[:3, :3].T)


@pytest.fixture(scope="module")
def pair():
    return Pair()


def bits(result):
    """Everything numeric of a result, to compare runs bit by bit."""
    details = result.details
    arrays = (
        details.transformation,
        details.sigmas,
        details.energies,
        details.transformations,
        details.row_weights,
    )
    return b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)


def test_a_tutorial_script_needs_only_the_functions_name_swapped(pair, capsys):
    names = {"o3d": o3d, "np": np, "registration_adaptive_gmm": registration_adaptive_gmm}
    names |= {"source": pair.source, "target": pair.target}
    assert "registration_icp" not in SWAPPED and "registration_generalized_icp" not in SWAPPED
    exec(TUTORIAL, dict(names))
    theirs = capsys.readouterr().out.splitlines()
    exec(SWAPPED, names)
    ours = capsys.readouterr().out.splitlines()
    assert [line.split("with")[0] for line in ours[:2]] == [line.split("with")[0] for line in theirs[:2]]
    assert len(ours) == len(theirs)
    for result in names["results"]:
        assert isinstance(result, reg.RegistrationResult)
        errors = pose_errors(pair.T, result.transformation)
        assert errors.rotation_deg < 2.0 and errors.translation < 0.02
    assert np.linalg.norm(names["closest"], axis=1).max() < names["threshold"]


def test_the_result_is_open3ds_and_counts_as_open3d_does(pair):
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05)
    expected = reg.evaluate_registration(pair.source, pair.target, 0.05, result.transformation)
    assert isinstance(result, reg.RegistrationResult)
    assert result.transformation.shape == (4, 4) and result.transformation.dtype == np.float64
    assert 0.0 < result.fitness <= 1.0
    assert result.fitness == expected.fitness
    # Open3D's threads add up, and list the pairs, in no fixed order.
    np.testing.assert_allclose(result.inlier_rmse, expected.inlier_rmse, rtol=1e-12, atol=0)
    pairs = np.asarray(expected.correspondence_set)
    np.testing.assert_array_equal(np.asarray(result.correspondence_set), pairs[np.argsort(pairs[:, 0])])
    assert len(result.correspondence_set) == round(result.fitness * len(pair.source.points))
    assert repr(result).startswith("RegistrationResult with fitness=")
    assert isinstance(result.details, PointRegistrationResult)
    np.testing.assert_array_equal(result.details.transformation, result.transformation)


def test_the_distance_changes_the_counts_and_not_the_pose(pair):
    near = registration_adaptive_gmm(pair.source, pair.target, 0.02)
    far = registration_adaptive_gmm(pair.source, pair.target, 0.2)
    np.testing.assert_array_equal(near.transformation, far.transformation)
    assert near.fitness < 0.9 and far.fitness > 0.99


def test_default_criteria_converge(pair):
    details = registration_adaptive_gmm(pair.source, pair.target, 0.05).details
    assert details.converged
    errors = pose_errors(pair.T, details.transformation)
    assert errors.rotation_deg < 1.0 and errors.translation < 0.01


@pytest.mark.parametrize(
    "criteria", [reg.ICPConvergenceCriteria(), o3d.t.pipelines.registration.ICPConvergenceCriteria()]
)
def test_open3ds_own_criteria_stand_for_the_default(pair, criteria):
    expected = registration_adaptive_gmm(pair.source, pair.target, 0.05)
    assert bits(registration_adaptive_gmm(pair.source, pair.target, 0.05, criteria=criteria)) == bits(expected)


def test_a_criterion_counts_as_soon_as_one_is_chosen(pair):
    def run(**chosen):
        criteria = reg.ICPConvergenceCriteria(**chosen)
        return registration_adaptive_gmm(pair.source, pair.target, 0.05, criteria=criteria).details

    default = registration_adaptive_gmm(pair.source, pair.target, 0.05).details
    for most in (*range(1, 30), *range(31, 40)):  # 30 is what Open3D has by default, which stands for ours
        details = run(max_iteration=most)
        assert details.iterations <= most and (details.converged or details.iterations == most)
        assert len(details.transformations) == len(details.sigmas) + 1 == details.iterations + 1
        # what is reported begins somewhere on the way of the search, which is the same, and ends at the pose
        assert (default.transformations == details.transformations[0]).all(axis=(1, 2)).any()
        np.testing.assert_array_equal(details.transformations[-1], details.transformation)
    assert run(relative_rmse=1e-9, max_iteration=2000).iterations > default.iterations


@pytest.mark.parametrize("init", [None, "given"])
def test_no_iterations_give_the_start_evaluated(pair, init):
    start = np.eye(4) if init is None else pair.T
    criteria = reg.ICPConvergenceCriteria(max_iteration=0)
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, None if init is None else start, None, criteria)
    theirs = reg.registration_icp(pair.source, pair.target, 0.05, start, criteria=criteria)
    np.testing.assert_array_equal(result.transformation, theirs.transformation)
    np.testing.assert_array_equal(result.transformation, start)
    assert result.fitness == theirs.fitness and result.details.iterations == 0
    assert result.details.warnings == ("not converged: max_iteration reached",)


def test_without_a_limit_every_point_counts(pair):
    result = registration_adaptive_gmm(pair.source, pair.target, np.inf)
    expected = reg.evaluate_registration(pair.source, pair.target, np.inf, result.transformation)
    assert result.fitness == expected.fitness == 1.0
    np.testing.assert_allclose(result.inlier_rmse, expected.inlier_rmse, rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    "method",
    [
        reg.TransformationEstimationPointToPoint(),
        reg.TransformationEstimationPointToPlane(),
        reg.TransformationEstimationForGeneralizedICP(),
        o3d.t.pipelines.registration.TransformationEstimationPointToPoint(),
        TransformationEstimationForAdaptiveGMM(),
    ],
    ids=lambda method: type(method).__name__,
)
def test_open3ds_estimation_methods_stand_for_the_default(pair, method):
    expected = registration_adaptive_gmm(pair.source, pair.target, 0.05)
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, np.eye(4), method)
    assert bits(result) == bits(expected)


@pytest.fixture
def log(caplog):
    """What is said once is said again."""
    _say_what_stands_for.cache_clear()
    caplog.set_level(logging.INFO, logger="adagmm_o3d")
    return caplog


tensor_kernel = o3d.t.pipelines.registration.robust_kernel


@pytest.mark.parametrize(
    ("method", "level", "said"),
    [
        (reg.TransformationEstimationPointToPlane(), "INFO", ""),
        (reg.TransformationEstimationPointToPlane(reg.L2Loss()), "INFO", ""),
        (reg.TransformationEstimationForGeneralizedICP(), "INFO", ""),
        (o3d.t.pipelines.registration.TransformationEstimationPointToPlane(), "INFO", ""),
        (
            # Made in the test: it holds a tensor, and Open3D ends a process with an error where one is left.
            o3d.t.pipelines.registration.TransformationEstimationForDopplerICP,
            "WARNING",
            "; Doppler velocities are not looked at",
        ),
        (
            reg.TransformationEstimationPointToPlane(reg.TukeyLoss(k=0.1)),
            "WARNING",
            "; the robust kernel TukeyLoss is not needed, as points without a partner have no weight",
        ),
        (
            o3d.t.pipelines.registration.TransformationEstimationPointToPlane(
                tensor_kernel.RobustKernel(tensor_kernel.RobustKernelMethod.HuberLoss, 0.1)
            ),
            "WARNING",
            "; the robust kernel HuberLoss is not needed, as points without a partner have no weight",
        ),
    ],
)
def test_what_stands_for_open3ds_method_is_said_once(pair, log, method, level, said):
    method = method() if isinstance(method, type) else method
    for _ in range(2):
        registration_adaptive_gmm(pair.source, pair.target, 0.05, np.eye(4), method)
    name = type(method).__name__
    assert [(r.levelname, r.getMessage()) for r in log.records] == [
        (level, f"estimation_method: {name} stands for TransformationEstimationForAdaptiveGMM(){said}")
    ]


def test_our_own_options_are_no_news(pair, log):
    for method in (None, TransformationEstimationForAdaptiveGMM()):
        registration_adaptive_gmm(pair.source, pair.target, 0.05, np.eye(4), method)
    assert log.records == []


def test_the_thickness_of_gicp_is_that_of_the_surface(pair):
    method = reg.TransformationEstimationForGeneralizedICP(epsilon=0.05)
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, np.eye(4), method)
    given = [
        legacy_cloud(np.asarray(c.points), covariances=estimate_surface_covariances(c.points, c.normals, epsilon=0.05))
        for c in (pair.source, pair.target)
    ]
    assert bits(result) == bits(registration_adaptive_gmm(*given, 0.05))
    assert bits(result) != bits(registration_adaptive_gmm(pair.source, pair.target, 0.05))


@pytest.mark.parametrize(("epsilon", "meant"), [(0.0, 1e-3), (2.0, 1.0)])
def test_a_thickness_that_is_none_of_a_surface_is_taken(pair, epsilon, meant):
    results = [
        registration_adaptive_gmm(
            pair.source, pair.target, 0.05, None, reg.TransformationEstimationForGeneralizedICP(epsilon=value)
        )
        for value in (epsilon, meant)
    ]
    assert bits(results[0]) == bits(results[1])


def test_init_is_where_it_starts(pair):
    init = random_pose(np.random.default_rng(3), 3, angle=0.05, distance=0.02) @ pair.T
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, init)
    np.testing.assert_allclose(result.details.transformations[0], init, rtol=0, atol=1e-9)
    errors = pose_errors(pair.T, result.transformation)
    assert errors.rotation_deg < 1.0 and errors.translation < 0.01


@pytest.mark.parametrize("digits", [5, 3])
def test_an_init_with_the_digits_of_a_text_file_is_taken(pair, digits):
    rounded = np.round(pair.T, digits)
    expected = registration_adaptive_gmm(pair.source, pair.target, 0.05, pair.T)
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, rounded)
    for transformation in (result.transformation, result.details.transformations[0]):
        rotation = transformation[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.details.transformations[0], pair.T, rtol=0, atol=10.0**-digits)
    np.testing.assert_allclose(result.transformation, expected.transformation, rtol=0, atol=1e-3)


def test_covariances_are_the_clouds_own(pair):
    rng = np.random.default_rng(5)
    scales = rng.uniform(1.0, 5.0, len(pair.source.points))
    covariances = scales[:, None, None] * np.eye(3)
    given = registration_adaptive_gmm(
        legacy_cloud(np.asarray(pair.source.points), covariances=covariances), pair.target, 0.05
    )
    without = registration_adaptive_gmm(pair.source, pair.target, 0.05)
    assert bits(given) != bits(without)


@pytest.mark.parametrize("with_normals", [True, False])
def test_covariances_that_are_missing_are_those_of_the_surface(pair, with_normals):
    bare, given = [], []
    for cloud in (pair.source, pair.target):
        points, normals = np.asarray(cloud.points), np.asarray(cloud.normals) if with_normals else None
        bare.append(legacy_cloud(points, normals))
        given.append(legacy_cloud(points, covariances=estimate_surface_covariances(points, normals)))
    assert bits(registration_adaptive_gmm(*given, 0.05)) == bits(registration_adaptive_gmm(*bare, 0.05))


def test_normals_may_have_any_length_and_sign(pair):
    signs = np.where(np.random.default_rng(6).random(len(pair.source.points)) < 0.5, -2.0, 0.5)[:, None]
    scaled = legacy_cloud(np.asarray(pair.source.points), signs * np.asarray(pair.source.normals))
    for voxel_size in (-1.0, 0.2):
        expected = registration_adaptive_gmm(pair.source, pair.target, 0.05, voxel_size=voxel_size)
        result = registration_adaptive_gmm(scaled, pair.target, 0.05, voxel_size=voxel_size)
        np.testing.assert_allclose(result.transformation, expected.transformation, rtol=0, atol=1e-6)


def test_neighbours_speak_for_points_without_a_normal(pair):
    points, normals = np.asarray(pair.source.points), np.array(pair.source.normals)
    covariances = estimate_surface_covariances(points, normals)
    covariances[:40] = estimate_surface_covariances(points)[:40]
    normals[:20], normals[20:40, 1] = 0.0, np.nan
    result = registration_adaptive_gmm(legacy_cloud(points, normals), pair.target, 0.05)
    expected = registration_adaptive_gmm(legacy_cloud(points, covariances=covariances), pair.target, 0.05)
    assert bits(result) == bits(expected)
    no_normals = registration_adaptive_gmm(legacy_cloud(points, 0.0 * normals), pair.target, 0.05)
    assert bits(no_normals) == bits(registration_adaptive_gmm(legacy_cloud(points), pair.target, 0.05))


def test_three_points_with_normals_are_enough():
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [0.0, 0.7, -0.2]])
    normals = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    cloud = legacy_cloud(points, normals)
    result = registration_adaptive_gmm(cloud, cloud, 0.05)
    np.testing.assert_allclose(result.transformation, np.eye(4), rtol=0, atol=1e-3)
    with pytest.raises(DegenerateError, match=r"^source\.points: expected more than 3 to estimate .*, got 3; pass"):
        registration_adaptive_gmm(legacy_cloud(points), cloud, 0.05)


@pytest.mark.parametrize("dtype", [None, o3d.core.float32, o3d.core.float64])
@pytest.mark.parametrize("voxel_size", [-1.0, 0.15])
def test_open3ds_covariances_of_flat_faces_are_taken(voxel_size, dtype):
    # A box alone is itself half a turn on, which is warned of.
    o3d.utility.random.seed(0)
    box = o3d.geometry.TriangleMesh.create_box
    body = box(1.0, 2.0, 3.0) + box(1.5, 0.7, 0.5).translate((1.0, 0.0, 0.0))
    source, target = body.sample_points_uniformly(3000), body.sample_points_uniformly(3000)
    T = random_pose(np.random.default_rng(0), 3, angle=0.2, distance=0.15)
    target.transform(T)
    for cloud in (source, target):
        cloud.estimate_covariances()
    clouds = [source, target]
    if dtype is not None:
        for k, cloud in enumerate((source, target)):
            clouds[k] = o3d.t.geometry.PointCloud.from_legacy(cloud, dtype)
            clouds[k].point.covariances = o3d.core.Tensor(np.asarray(cloud.covariances), dtype)
    result = registration_adaptive_gmm(*clouds, 0.1, np.eye(4), voxel_size=voxel_size)
    least = 1000 if voxel_size < 0 else 200
    assert result.details.regularised_source > least and result.details.regularised_target > least
    assert result.details.trustworthy
    errors = pose_errors(T, result.details.transformation)
    assert errors.rotation_deg < 0.02 and errors.translation < 1e-3


@pytest.mark.parametrize("seed", range(3))
def test_a_box_is_said_to_fit_as_well_half_a_turn_on(seed):
    o3d.utility.random.seed(seed)
    box = o3d.geometry.TriangleMesh.create_box(1.0, 2.0, 3.0)
    clouds = [box.sample_points_uniformly(3000) for _ in range(2)]
    clouds[1].transform(random_pose(np.random.default_rng(seed), 3, angle=0.2, distance=0.15))
    result = registration_adaptive_gmm(*clouds, 0.1, np.eye(4), voxel_size=0.15)
    assert any("symmetric shape" in warning for warning in result.details.warnings)


def test_one_factor_on_all_covariances_changes_nothing(pair):
    def run(factor):
        clouds = [
            legacy_cloud(np.asarray(c.points), covariances=factor * estimate_surface_covariances(np.asarray(c.points)))
            for c in (pair.source, pair.target)
        ]
        return registration_adaptive_gmm(*clouds, 0.05).transformation

    np.testing.assert_allclose(run(3.7e-6), run(1.0), rtol=0, atol=1e-6)


def test_the_clouds_are_not_modified(pair):
    def state(cloud):
        return b"".join(np.asarray(a).tobytes() for a in (cloud.points, cloud.normals, cloud.covariances))

    source = legacy_cloud(
        np.asarray(pair.source.points), np.asarray(pair.source.normals), np.tile(2.0 * np.eye(3), (500, 1, 1))
    )
    target = legacy_cloud(np.asarray(pair.target.points), np.asarray(pair.target.normals))
    before = state(source), state(target)
    registration_adaptive_gmm(source, target, 0.05, voxel_size=0.05)
    registration_adaptive_gmm(source, target, 0.05)
    assert (state(source), state(target)) == before


def test_voxels_thin_both_clouds_first(pair):
    bare = [legacy_cloud(np.asarray(c.points)) for c in (pair.source, pair.target)]
    thinned = [c.voxel_down_sample(0.2) for c in bare]
    assert len(thinned[0].points) < 300
    expected = registration_adaptive_gmm(*thinned, 0.05)
    result = registration_adaptive_gmm(*bare, 0.05, voxel_size=0.2)
    assert bits(result) == bits(expected)
    assert len(result.details.row_weights) == len(thinned[0].points)


def test_the_callback_sees_every_iteration(pair):
    seen = []
    result = registration_adaptive_gmm(pair.source, pair.target, 0.05, callback_after_iteration=seen.append)
    assert all(set(s) == CALLBACK_KEYS for s in seen)
    assert [s["iteration_index"] for s in seen] == list(range(result.details.iterations))
    np.testing.assert_array_equal([s["transformation"] for s in seen], result.details.transformations[1:])
    np.testing.assert_array_equal([s["sigma"] for s in seen], result.details.sigmas)
    np.testing.assert_array_equal([s["energy"] for s in seen], result.details.energies)
    levels = [s["scale_index"] for s in seen]
    assert levels == sorted(levels)
    for level in set(levels):
        inside = [s["scale_iteration_index"] for s in seen if s["scale_index"] == level]
        assert inside == list(range(len(inside)))
    assert all(0.0 <= s["fitness"] <= 1.0 and 0.0 < s["inlier_rmse"] < 2.0 for s in seen)


def test_an_error_of_the_callback_comes_through_as_it_is(pair):
    def stop(_):
        raise StopIteration("enough")

    with pytest.raises(StopIteration, match="enough"):
        registration_adaptive_gmm(pair.source, pair.target, 0.05, callback_after_iteration=stop)


def test_the_same_call_gives_the_same_bits(pair):
    first, second = (registration_adaptive_gmm(pair.source, pair.target, 0.05) for _ in range(2))
    assert bits(first) == bits(second)


@pytest.mark.slow
def test_the_same_bits_on_one_thread_and_on_two():
    script = (
        "import sys, hashlib; sys.path[:0] = sys.argv[1:]; import test_registration as t\n"
        "pair = t.Pair(n=1500)\n"
        "found = t.registration_adaptive_gmm(pair.source, pair.target, 0.05)\n"
        "clouds = (t.o3d.t.geometry.PointCloud.from_legacy(cloud) for cloud in (pair.source, pair.target))\n"
        "tensor = t.registration_adaptive_gmm(*clouds, 0.05)\n"
        "counted = [t.np.asarray(found.correspondence_set), tensor.correspondence_set.numpy()]\n"
        "counted += [(r.fitness, r.inlier_rmse) for r in (found, tensor)]\n"
        "print(hashlib.sha256(t.bits(found) + b''.join(t.np.array(c).tobytes() for c in counted)).hexdigest())"
    )

    def run(threads):
        environment = os.environ | {name: str(threads) for name in ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS")}
        return subprocess.run(
            [sys.executable, "-c", script, *(str(Path(__file__).parents[1] / room) for room in ("plugin", "support"))],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            timeout=300,
        ).stdout

    assert run(1) == run(2)
