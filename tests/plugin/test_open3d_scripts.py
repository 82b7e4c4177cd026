"""What Open3D's registration tests and tutorials do, with only the function's name changed.

Each script is run with Open3D's function and with ours in its place; ours has to find the pose, and the scripts have to
get everything from it that they get from Open3D's. The clouds are our own.
"""

import copy

import numpy as np
import open3d as o3d
import pytest
from mixtures import random_pose
from shapes import bumpy_ellipsoid, move
from shared_data import shared_data

from adagmm_o3d import AdaGMMError, multi_scale_registration_adaptive_gmm, registration_adaptive_gmm
from adagmm_o3d.evaluation import information_matrix, pose_errors
from adagmm_o3d.lie import project_to_rotation, se_inverse

core, reg, treg = o3d.core, o3d.pipelines.registration, o3d.t.pipelines.registration

# The start that Open3D's documentation and tests write down, to three digits.
TUTORIAL_INIT = np.asarray(
    [[0.862, 0.011, -0.507, 0.5], [-0.139, 0.967, -0.215, 0.7], [0.487, 0.255, 0.835, -1.4], [0.0, 0.0, 0.0, 1.0]]
)
FLOATS = [core.float32, core.float64]
IMAGES = (("color", "jpg"), ("depth", "png"))


class Scene:
    """Two samplings of one surface whose true pose is a few degrees and centimetres from the tutorial's start."""

    def __init__(self, n=600, noise=0.002, seed=0):
        rng = np.random.default_rng(seed)
        nearest = np.eye(4)
        nearest[:3, :3], nearest[:3, 3] = project_to_rotation(TUTORIAL_INIT[:3, :3]), TUTORIAL_INIT[:3, 3]
        self.T = random_pose(rng, 3, angle=np.radians(4.0), distance=0.05) @ nearest
        points, normals = bumpy_ellipsoid(rng, 2 * n)
        shades = 0.5 + 0.4 * np.sin(7.0 * points)
        points += noise * rng.normal(size=points.shape)
        back = se_inverse(self.T)
        self.source = legacy_cloud(move(points[:n], back), normals[:n] @ back[:3, :3].T)
        self.target = legacy_cloud(points[n:], normals[n:])
        for cloud, own in ((self.source, shades[:n]), (self.target, shades[n:])):
            cloud.colors = o3d.utility.Vector3dVector(own)

    def tensors(self, dtype):
        return [o3d.t.geometry.PointCloud.from_legacy(cloud, dtype) for cloud in (self.source, self.target)]


def legacy_cloud(points, normals=None):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    if normals is not None:
        cloud.normals = o3d.utility.Vector3dVector(normals)
    return cloud


def assert_as_good(T, ours, theirs):
    """Right, and not much further from the truth than Open3D's."""
    ours, theirs = (np.asarray(t.numpy() if isinstance(t, core.Tensor) else t) for t in (ours, theirs))
    found, other = pose_errors(T, ours), pose_errors(T, theirs)
    assert found.rotation_deg < max(0.5, 1.5 * other.rotation_deg)
    assert found.translation < max(0.01, 1.5 * other.translation)


@pytest.fixture(scope="module")
def scene():
    return Scene()


# Legacy clouds: the ICP, GICP and robust kernel pages


def point_to_point(scene, icp):
    return icp(scene.source, scene.target, 0.2, TUTORIAL_INIT, reg.TransformationEstimationPointToPoint())


def point_to_point_for_long(scene, icp):
    criteria = reg.ICPConvergenceCriteria(max_iteration=2000)
    method = reg.TransformationEstimationPointToPoint()
    return icp(scene.source, scene.target, 0.2, TUTORIAL_INIT, method, criteria)


def point_to_plane(scene, icp):
    return icp(scene.source, scene.target, 0.2, TUTORIAL_INIT, reg.TransformationEstimationPointToPlane())


def symmetric(scene, icp):
    if not hasattr(reg, "TransformationEstimationSymmetric"):
        pytest.skip("this Open3D has no symmetric ICP")
    return icp(scene.source, scene.target, 0.2, TUTORIAL_INIT, reg.TransformationEstimationSymmetric())


def by_name(scene, icp):
    return icp(
        source=scene.source,
        target=scene.target,
        max_correspondence_distance=0.2,
        init=TUTORIAL_INIT,
        estimation_method=reg.TransformationEstimationPointToPoint(),
        criteria=reg.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=30),
    )


def after_downsampling(scene, icp):
    clouds = [cloud.voxel_down_sample(0.1) for cloud in (scene.source, scene.target)]
    for cloud in clouds:
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.2, max_nn=30))
    return icp(*clouds, 0.2, TUTORIAL_INIT, reg.TransformationEstimationPointToPlane())


@pytest.mark.parametrize("script", [point_to_point, point_to_point_for_long, point_to_plane, by_name])
def test_icp(scene, script):
    ours, theirs = script(scene, registration_adaptive_gmm), script(scene, reg.registration_icp)
    assert_as_good(scene.T, ours.transformation, theirs.transformation)
    assert isinstance(ours, reg.RegistrationResult)
    assert ours.fitness >= theirs.fitness - 0.02 and ours.inlier_rmse <= theirs.inlier_rmse + 0.005
    assert len(ours.correspondence_set) == round(ours.fitness * len(scene.source.points))


@pytest.mark.parametrize("script", [symmetric, after_downsampling])
def test_icp_of_other_kinds(scene, script):
    ours, theirs = script(scene, registration_adaptive_gmm), script(scene, reg.registration_icp)
    assert_as_good(scene.T, ours.transformation, theirs.transformation)


def with_estimated_normals(source, target):
    for cloud in (source, target):
        cloud.estimate_normals()


def with_estimated_covariances(source, target):
    for cloud in (source, target):
        cloud.estimate_covariances()


def bare(source, target):
    for cloud in (source, target):
        cloud.normals = o3d.utility.Vector3dVector()


@pytest.mark.parametrize("prepare", [bare, with_estimated_normals, with_estimated_covariances])
@pytest.mark.parametrize("epsilon", [None, 1e-2])
def test_generalised_icp(scene, prepare, epsilon):
    def script(icp):
        source, target = copy.deepcopy(scene.source), copy.deepcopy(scene.target)
        prepare(source, target)
        method = reg.TransformationEstimationForGeneralizedICP()
        if epsilon is not None:
            method = reg.TransformationEstimationForGeneralizedICP(epsilon)
        criteria = reg.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=50)
        return icp(source, target, 0.2, TUTORIAL_INIT, method, criteria)

    ours, theirs = script(registration_adaptive_gmm), script(reg.registration_generalized_icp)
    assert_as_good(scene.T, ours.transformation, theirs.transformation)


@pytest.mark.parametrize(
    "loss", [reg.TukeyLoss(k=0.05), reg.HuberLoss(k=0.05), reg.CauchyLoss(k=0.05), reg.GMLoss(k=0.05), reg.L1Loss()]
)
@pytest.mark.parametrize(
    "method", [reg.TransformationEstimationPointToPlane, reg.TransformationEstimationForGeneralizedICP]
)
def test_robust_kernels(scene, loss, method):
    noisy = copy.deepcopy(scene.source)
    rng = np.random.default_rng(1)
    noisy.points = o3d.utility.Vector3dVector(np.asarray(noisy.points) + rng.normal(0.0, 0.01, (600, 3)))
    plane = method is reg.TransformationEstimationPointToPlane
    function = reg.registration_icp if plane else reg.registration_generalized_icp
    estimation = method(loss) if plane else method(1e-3, loss)
    theirs = function(noisy, scene.target, 0.3, TUTORIAL_INIT, estimation)
    ours = registration_adaptive_gmm(noisy, scene.target, 0.3, TUTORIAL_INIT, estimation)
    assert_as_good(scene.T, ours.transformation, theirs.transformation)


def test_coarse_to_fine_by_hand(scene):
    """As the page on coloured ICP does it: each radius with clouds of its own, from the last transformation."""
    current = TUTORIAL_INIT
    for radius, most in zip([0.2, 0.1, 0.05], [50, 30, 14], strict=True):
        clouds = [cloud.voxel_down_sample(radius) for cloud in (scene.source, scene.target)]
        for cloud in clouds:
            cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=radius * 2, max_nn=30))
        result = registration_adaptive_gmm(
            *clouds,
            radius,
            current,
            reg.TransformationEstimationForColoredICP(),
            reg.ICPConvergenceCriteria(relative_fitness=1e-6, relative_rmse=1e-6, max_iteration=most),
        )
        assert result.details.iterations <= most or most == 30  # Open3D's own default, which stands for ours
        current = result.transformation
    errors = pose_errors(scene.T, current)
    assert errors.rotation_deg < 0.5 and errors.translation < 0.01


def test_what_is_evaluated_is_what_open3d_evaluates(scene):
    ours = point_to_plane(scene, registration_adaptive_gmm)
    again = reg.evaluate_registration(scene.source, scene.target, 0.2, ours.transformation)
    assert (ours.fitness, len(ours.correspondence_set)) == (again.fitness, len(again.correspondence_set))
    matrix = reg.get_information_matrix_from_point_clouds(scene.source, scene.target, 0.2, ours.transformation)
    mine = information_matrix(scene.source.points, scene.target.points, 0.2, ours.transformation)
    np.testing.assert_allclose(mine, matrix, rtol=1e-9, atol=1e-6)


# Nothing known of the pose: the page on global registration


def global_then_local(scene, icp):
    """Features on both clouds, RANSAC on their correspondences, and its pose refined."""
    voxel, clouds, features = 0.1, [], []
    for cloud in (scene.source, scene.target):
        down = cloud.voxel_down_sample(voxel)
        down.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=2 * voxel, max_nn=30))
        clouds.append(down)
        search = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * voxel, max_nn=100)
        features.append(reg.compute_fpfh_feature(down, search))
    o3d.utility.random.seed(0)
    coarse = reg.registration_ransac_based_on_feature_matching(
        *clouds,
        *features,
        True,
        1.5 * voxel,
        reg.TransformationEstimationPointToPoint(False),
        3,
        [
            reg.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            reg.CorrespondenceCheckerBasedOnDistance(1.5 * voxel),
        ],
        reg.RANSACConvergenceCriteria(100000, 0.999),
    )
    plane = reg.TransformationEstimationPointToPlane()
    return icp(scene.source, scene.target, 0.4 * voxel, coarse.transformation, plane)


def test_global_registration(scene):
    errors = pose_errors(scene.T, global_then_local(scene, registration_adaptive_gmm).transformation)
    theirs = pose_errors(scene.T, global_then_local(scene, reg.registration_icp).transformation)
    assert errors.rotation_deg < 0.5 and errors.translation < 0.01
    assert theirs.rotation_deg < 1.0 and theirs.translation < 0.03  # the script works


def test_clouds_without_velocities_are_registered_where_doppler_icp_was_asked_for(scene):
    method = treg.TransformationEstimationForDopplerICP()
    result = registration_adaptive_gmm(*scene.tensors(core.float64), 0.2, core.Tensor(TUTORIAL_INIT), method)
    errors = pose_errors(scene.T, result.transformation.numpy())
    assert errors.rotation_deg < 0.5 and errors.translation < 0.01


# Several views: the page on multiway registration


def multiway(clouds, icp, distance):
    """Pose graph of all pairs, odometry edges certain; the poses of all clouds in the frame of the first."""
    graph, odometry = reg.PoseGraph(), np.eye(4)
    graph.nodes.append(reg.PoseGraphNode(odometry))
    plane = reg.TransformationEstimationPointToPlane()
    for i, source in enumerate(clouds):
        for j, target in list(enumerate(clouds))[i + 1 :]:
            coarse = icp(source, target, 15.0 * distance, np.identity(4), plane)
            fine = icp(source, target, 1.5 * distance, coarse.transformation, plane)
            matrix = reg.get_information_matrix_from_point_clouds(source, target, 1.5 * distance, fine.transformation)
            if j == i + 1:
                odometry = fine.transformation @ odometry
                graph.nodes.append(reg.PoseGraphNode(np.linalg.inv(odometry)))
            graph.edges.append(reg.PoseGraphEdge(i, j, fine.transformation, matrix, uncertain=j != i + 1))
    reg.global_optimization(
        graph,
        reg.GlobalOptimizationLevenbergMarquardt(),
        reg.GlobalOptimizationConvergenceCriteria(),
        reg.GlobalOptimizationOption(max_correspondence_distance=1.5 * distance, reference_node=0),
    )
    return [node.pose for node in graph.nodes]


def test_multiway_registration():
    rng = np.random.default_rng(3)
    poses = [np.eye(4), *(random_pose(rng, 3, angle=np.radians(8.0), distance=0.05) for _ in range(3))]
    clouds = []
    for pose in poses:
        points, normals = bumpy_ellipsoid(rng, 800)
        back = se_inverse(pose)
        clouds.append(legacy_cloud(move(points, back), normals @ back[:3, :3].T))
    ours, theirs = multiway(clouds, registration_adaptive_gmm, 0.03), multiway(clouds, reg.registration_icp, 0.03)
    for pose, mine, other in zip(poses, ours, theirs, strict=True):
        assert_as_good(pose, mine, other)


def test_multiway_registration_of_kinect_frames():
    folder = shared_data("recordings", "redwood_open3d_5frames")
    parameters = o3d.camera.PinholeCameraIntrinsicParameters.PrimeSenseDefault
    intrinsic = o3d.camera.PinholeCameraIntrinsic(parameters)
    trajectory = o3d.io.read_pinhole_camera_trajectory(str(folder / "trajectory.log"))
    truth = [np.linalg.inv(camera.extrinsic) for camera in trajectory.parameters]
    clouds = []
    for k in (0, 2, 4):
        color, depth = (o3d.io.read_image(str(folder / f"{what}/{k:05d}.{kind}")) for what, kind in IMAGES)
        frame = o3d.geometry.RGBDImage.create_from_color_and_depth(color, depth, 1000.0, 4.0, False)
        clouds.append(o3d.geometry.PointCloud.create_from_rgbd_image(frame, intrinsic).voxel_down_sample(0.05))
        clouds[-1].estimate_normals()
    poses = multiway(clouds, registration_adaptive_gmm, 0.05)
    for k, pose in zip((0, 2, 4), poses, strict=True):
        errors = pose_errors(np.linalg.inv(truth[0]) @ truth[k], pose)
        assert errors.rotation_deg < 0.2 and errors.translation < 0.012


# Tensor clouds: the page on tensor ICP, and the tests of its bindings


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("init_dtype", FLOATS)
@pytest.mark.parametrize(
    "method",
    [
        treg.TransformationEstimationPointToPoint(),
        treg.TransformationEstimationPointToPlane(),
        treg.TransformationEstimationPointToPlane(
            treg.robust_kernel.RobustKernel(treg.robust_kernel.RobustKernelMethod.TukeyLoss, 0.1)
        ),
    ],
)
def test_tensor_icp(scene, dtype, init_dtype, method):
    source, target = scene.tensors(dtype)
    init = core.Tensor(TUTORIAL_INIT, init_dtype)
    results = [icp(source, target, 0.2, init, method) for icp in (registration_adaptive_gmm, treg.icp)]
    ours, theirs = results
    assert_as_good(scene.T, ours.transformation, theirs.transformation)
    for result in results:
        assert result.transformation.dtype == core.float64 and tuple(result.transformation.shape) == (4, 4)
        assert result.transformation.device == core.Device("CPU:0")
        assert result.correspondence_set.dtype == core.int64
        assert isinstance(result.fitness, float) and isinstance(result.inlier_rmse, float)
        assert isinstance(result.converged, bool) and isinstance(result.num_iterations, int)


@pytest.mark.parametrize("dtype", FLOATS)
@pytest.mark.parametrize("most", [1, 2])
def test_two_iterations_of_tensor_icp_are_those_of_legacy_icp(scene, dtype, most):
    """How Open3D's tests compare the two: few iterations from the tutorial's start, fitness and inlier_rmse alike."""
    source, target = scene.tensors(dtype)
    init = core.Tensor(TUTORIAL_INIT)
    tensor = registration_adaptive_gmm(
        source,
        target,
        1.25,
        init,
        treg.TransformationEstimationPointToPoint(),
        treg.ICPConvergenceCriteria(max_iteration=most),
        -1.0,
    )
    legacy = registration_adaptive_gmm(
        source.to_legacy(),
        target.to_legacy(),
        1.25,
        TUTORIAL_INIT,
        reg.TransformationEstimationPointToPoint(),
        reg.ICPConvergenceCriteria(max_iteration=most),
    )
    assert tensor.num_iterations == legacy.details.iterations <= most
    np.testing.assert_allclose(tensor.inlier_rmse, legacy.inlier_rmse, rtol=1e-5, atol=0)
    np.testing.assert_allclose(tensor.fitness, legacy.fitness, rtol=1e-5, atol=0)
    np.testing.assert_allclose(tensor.transformation.numpy(), legacy.transformation, rtol=0, atol=1e-9)


def test_tensor_icp_with_a_callback(scene):
    source, target = scene.tensors(core.float32)
    lines = []
    result = registration_adaptive_gmm(
        source,
        target,
        0.2,
        core.Tensor(TUTORIAL_INIT),
        treg.TransformationEstimationPointToPlane(),
        treg.ICPConvergenceCriteria(relative_fitness=0.000001, relative_rmse=0.000001, max_iteration=50),
        0.05,
        lambda values: lines.append(
            "Iteration Index: {}, Scale Index: {}, Scale Iteration Index: {}, Fitness: {}, Inlier RMSE: {},".format(
                values["iteration_index"].item(),
                values["scale_index"].item(),
                values["scale_iteration_index"].item(),
                values["fitness"].item(),
                values["inlier_rmse"].item(),
            )
        ),
    )
    assert len(lines) == result.num_iterations <= 50
    assert lines[0].startswith("Iteration Index: 0, Scale Index: ")


@pytest.mark.parametrize("dtype", FLOATS)
def test_multi_scale_tensor_icp(scene, dtype):
    source, target = scene.tensors(dtype)
    arguments = (
        source,
        target,
        o3d.utility.DoubleVector([0.2, 0.1, 0.05]),
        [
            treg.ICPConvergenceCriteria(relative_fitness=0.0001, relative_rmse=0.0001, max_iteration=20),
            treg.ICPConvergenceCriteria(0.00001, 0.00001, 15),
            treg.ICPConvergenceCriteria(0.000001, 0.000001, 10),
        ],
        o3d.utility.DoubleVector([0.5, 0.3, 0.15]),
        core.Tensor(TUTORIAL_INIT),
        treg.TransformationEstimationPointToPlane(),
    )
    results, seen = [], []
    for icp in (multi_scale_registration_adaptive_gmm, treg.multi_scale_icp):
        scales = []
        results.append(icp(*arguments, callback_after_iteration=lambda v, s=scales: s.append(v["scale_index"].item())))
        seen.append(scales)
    assert_as_good(scene.T, *(result.transformation for result in results))
    assert all(sorted(set(scales)) == [0, 1, 2] and scales == sorted(scales) for scales in seen)
    assert results[0].num_iterations == len(seen[0]) <= 20 + 15 + 10


@pytest.mark.parametrize("dtype", FLOATS)
def test_tensor_information_matrix(scene, dtype):
    source, target = scene.tensors(dtype)
    result = registration_adaptive_gmm(source, target, 0.2, core.Tensor(TUTORIAL_INIT))
    matrix = treg.get_information_matrix(source, target, 0.2, result.transformation).numpy()
    points = [cloud.point.positions.numpy() for cloud in (source, target)]
    mine = information_matrix(*points, 0.2, result.transformation.numpy())
    np.testing.assert_allclose(mine, matrix, rtol=1e-4, atol=1e-4 * np.abs(matrix).max())


def refused_by_both(call):
    for function, error in ((treg.icp, (RuntimeError, IndexError)), (registration_adaptive_gmm, AdaGMMError)):
        with pytest.raises(error):
            call(function)


def test_what_open3d_refuses_is_refused(scene):
    narrow, wide = scene.tensors(core.float32), scene.tensors(core.float64)
    refused_by_both(lambda icp: icp(narrow[0], wide[1], 0.2))
    refused_by_both(lambda icp: icp(wide[0], narrow[1], 0.2))
    refused_by_both(lambda icp: icp(o3d.t.geometry.PointCloud(), wide[1], 0.2))
    refused_by_both(lambda icp: icp(wide[0], wide[1], -0.2))
    refused_by_both(lambda icp: icp(wide[0], wide[1], 0.2, core.Tensor(np.eye(3))))
