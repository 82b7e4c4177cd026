"""What the registration says to bad input: the beginning of the one line, and its type."""

import re

import numpy as np
import open3d as o3d
import pytest
from shapes import bumpy

from adagmm_o3d import (
    AdaGMMError,
    DegenerateError,
    DeviceError,
    InputError,
    InputTypeError,
    TransformationEstimationForAdaptiveGMM,
    mark_outliers,
    register_points,
    registration_adaptive_gmm,
)
from adagmm_o3d.options import Criteria

reg, treg, core = o3d.pipelines.registration, o3d.t.pipelines.registration, o3d.core

N = 60
POINTS = {d: bumpy(np.random.default_rng(d), N, d) for d in (2, 3)}
UNIT = np.tile(np.eye(3), (N, 1, 1))
LITTLE_MEASURED = np.where(np.arange(N)[:, None] < N - 2, np.nan, POINTS[3])
LINE = np.linspace(0.0, 1.0, N)[:, None] * np.array([1.0, 2.0, 3.0])
SCALED = np.diag([2.0, 2.0, 2.0, 1.0])
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
SLIGHTLY_SCALED = np.diag([1.006, 1.006, 1.006, 1.0])
SHEARED = np.eye(4) + 0.02 * np.eye(4, k=1) * [[1.0], [0.0], [0.0], [0.0]]


def at(index, value, array=UNIT):
    changed = array.copy()
    changed[index] = value
    return changed


# What every front end says of a cloud; for `register_points` as arrays, for the others as clouds.
POINT_CASES = [
    (POINTS[3][:0], InputError, "points: the cloud is empty; registration needs at least 3 points"),
    (POINTS[3][:1], DegenerateError, "points: 1 point cannot fix a pose; at least 3 are needed"),
    (POINTS[3][:2], DegenerateError, "points: 2 points cannot fix a pose; at least 3 are needed"),
    (np.full((N, 3), 7.1), DegenerateError, "points: all 60 points are in one place; a pose cannot be found"),
    (np.full((N, 3), 1e6 + 0.1), DegenerateError, "points: all 60 points are in one place; a pose cannot be found"),
    (LINE, DegenerateError, "points: all 60 points are on one line; a pose cannot be found"),
    (np.full((N, 3), np.nan), InputError, "points: not one of the 60 points is finite"),
    (
        LITTLE_MEASURED,
        DegenerateError,
        "points: 2 points cannot fix a pose; at least 3 are needed (58 more are not finite)",
    ),
]
COVARIANCE_CASES = [
    (np.zeros((N, 3, 3)), InputError, "covariances: all 60 are zero; leave them out if nothing is known"),
    (
        -UNIT,
        InputError,
        "covariances: not positive semidefinite at index 0 (60 in all); no covariance has a negative eigenvalue",
    ),
    (at(9, np.diag([1.0, 1.0, -1e-4])), InputError, "covariances: not positive semidefinite at index 9 (1 in all)"),
    (at(9, -np.eye(3)), InputError, "covariances: not positive semidefinite at index 9 (1 in all)"),
    (at((9, 0, 1), 0.5), InputError, "covariances: not symmetric at index 9 (1 in all)"),
    (
        np.full((N, 3, 3), np.nan),
        InputError,
        "covariances: 60 of 60 are not finite, the first at index 0; at most 1% may be (those points are ignored)",
    ),
    (at(slice(5, 8), np.inf), InputError, "covariances: 3 of 60 are not finite, the first at index 5"),
]
ARRAY_CASES = [
    (LINE + 1e6, DegenerateError, "points: all 60 points are on one line; a pose cannot be found"),
    (None, InputTypeError, "points: expected an array of real numbers, got NoneType"),
    ("cloud.ply", InputTypeError, "points: expected an array of real numbers, got str"),
    ([[0.0, 1.0], [2.0]], InputTypeError, "points: expected an array of real numbers, got a ragged list"),
    (POINTS[3] + 1j, InputTypeError, "points: expected an array of real numbers, got dtype complex128"),
    (
        np.where(POINTS[3] > 0, POINTS[3].astype(object), "1.0"),
        InputTypeError,
        "points: expected an array of real numbers, got dtype object",
    ),
    (POINTS[3] > 0, InputTypeError, "points: expected an array of real numbers, got dtype bool"),
    (POINTS[3][:, 0], InputError, "points: expected shape (n, 2 or 3), got (60,)"),
    (POINTS[3][:, :1], InputError, "points: expected shape (n, 2 or 3), got (60, 1)"),
    (np.zeros((N, 4)), InputError, "points: expected shape (n, 2 or 3), got (60, 4)"),
    (np.zeros((1, N, 3)), InputError, "points: expected shape (n, 2 or 3), got (1, 60, 3)"),
    (1e150 * POINTS[3], InputError, "points: expected coordinates up to 1e+140, got 1."),
    (POINTS[3] * np.longdouble("1e4000"), InputError, "points: not one of the 60 points is finite"),
    (1e-150 * POINTS[3], InputError, "points: expected an extent of 1e-140 or more, got 1."),
]
ARRAY_COVARIANCE_CASES = [
    ("kinect", InputTypeError, "covariances: expected an array of real numbers, got str"),
    (np.eye(3), InputError, "covariances: expected shape (60, 3, 3), got (3, 3)"),
    (UNIT[:-1], InputError, "covariances: expected shape (60, 3, 3), got (59, 3, 3)"),
    (UNIT[:, :2, :2], InputError, "covariances: expected shape (60, 3, 3), got (60, 2, 2)"),
    (np.ones(N), InputError, "covariances: expected shape (60, 3, 3), got (60,)"),
]
INIT_CASES = [
    ("far", InputError, "init: expected a pose or 'global', got 'far'"),
    (object(), InputTypeError, "init: expected an array of real numbers, got object"),
    (np.eye(3), InputError, "init: expected shape (4, 4), got (3, 3)"),
    (np.eye(4)[:3], InputError, "init: expected a square matrix, got shape (3, 4)"),
    (np.eye(5), InputError, "init: expected shape (3 or 4, 3 or 4), got (5, 5)"),
    (np.eye(4).ravel(), InputError, "init: expected shape (3 or 4, 3 or 4), got (16,)"),
    (np.full((4, 4), np.nan), InputError, "init: expected finite numbers, got nan at index (0, 0)"),
    (np.full((4, 4), np.inf), InputError, "init: expected finite numbers, got inf at index (0, 0)"),
    (np.zeros((4, 4)), InputError, "init: expected a homogeneous matrix with last row (0, 0, 0, 1), got (0, 0, 0, 0)"),
    (
        np.eye(4) + np.eye(4)[::-1],
        InputError,
        "init: expected a homogeneous matrix with last row (0, 0, 0, 1)",
    ),
    (SCALED, InputError, "init: expected a rotation, got determinant 8 and RᵀR − I up to 3; see project_to_rotation()"),
    (MIRROR, InputError, "init: expected a rotation, got determinant -1 and RᵀR − I up to 0"),
    (
        SLIGHTLY_SCALED,
        InputError,
        "init: expected a rotation, got determinant 1.01811 and RᵀR − I up to 0.012; see project_to_rotation()",
    ),
    (SHEARED, InputError, "init: expected a rotation, got determinant 1 and RᵀR − I up to 0.02"),
]
DEVICE_CASES = [
    ("tpu", DeviceError, "device: expected "),
    ("", DeviceError, "device: expected "),
    (None, DeviceError, "device: expected "),
    (3, DeviceError, "device: expected "),
]
SETTING_CASES = [
    ("criteria", 30, InputTypeError, "criteria: expected Open3D's ICPConvergenceCriteria, got int"),
    ("criteria", {"max_iteration": 30}, InputTypeError, "criteria: expected Open3D's ICPConvergenceCriteria, got dict"),
    (
        "criteria",
        reg.ICPConvergenceCriteria(max_iteration=-1),
        InputError,
        "criteria.max_iteration: expected an integer >= 0, got -1",
    ),
    ("criteria", Criteria(1e-3, 20.5), InputTypeError, "criteria.max_iteration: expected an integer, got float"),
    ("criteria", Criteria("a", 20), InputTypeError, "criteria.relative_rmse: expected a real number, got str"),
    ("criteria", Criteria(None, 20), InputTypeError, "criteria.relative_rmse: expected a real number, got NoneType"),
    ("criteria", Criteria(1e-3, None), InputTypeError, "criteria.max_iteration: expected an integer, got NoneType"),
    (
        "criteria",
        treg.ICPConvergenceCriteria(1e-6, -1.0, 30),
        InputError,
        "criteria.relative_rmse: expected a finite number >= 0, got -1",
    ),
    (
        "criteria",
        reg.ICPConvergenceCriteria(relative_rmse=np.nan),
        InputError,
        "criteria.relative_rmse: expected a finite number >= 0, got nan",
    ),
    (
        "criteria",
        reg.ICPConvergenceCriteria(relative_rmse=np.inf),
        InputError,
        "criteria.relative_rmse: expected a finite number >= 0, got inf",
    ),
    (
        "estimation_method",
        "icp",
        InputTypeError,
        "estimation_method: expected TransformationEstimationForAdaptiveGMM() or one of Open3D's, got str",
    ),
    (
        "estimation_method",
        TransformationEstimationForAdaptiveGMM,
        InputTypeError,
        "estimation_method: expected TransformationEstimationForAdaptiveGMM() or one of Open3D's, "
        "got the class TransformationEstimationForAdaptiveGMM; add ()",
    ),
    (
        "estimation_method",
        reg.TransformationEstimationPointToPoint(True),
        InputError,
        "estimation_method: with_scaling is on, but a rigid registration estimates no scale; turn it off",
    ),
    (
        "callback_after_iteration",
        "print",
        InputTypeError,
        "callback_after_iteration: expected a function of one dictionary, got str",
    ),
]
OPTION_CASES = [
    (
        {"sigma_rule": "fixed"},
        InputError,
        "sigma_rule: expected one of 'posterior', 'annealed', 'nearest', 'figure2', got 'fixed'",
    ),
    ({"sigma_rule": None}, InputError, "sigma_rule: expected one of 'posterior', "),
    ({"sigma_rule": ["nearest"]}, InputError, "sigma_rule: expected one of 'posterior', "),
    ({"start": "far"}, InputError, "start: expected one of 'auto', 'init', 'centroids', got 'far'"),
    ({"start": 0}, InputError, "start: expected one of 'auto', 'init', 'centroids', got int"),
    ({"start": np.eye(4)}, InputError, "start: expected one of 'auto', 'init', 'centroids', got ndarray"),
    (
        {"sigma_rule": np.array(["posterior", "nearest"])},
        InputError,
        "sigma_rule: expected one of 'posterior', 'annealed', 'nearest', 'figure2', got ndarray",
    ),
    ({"search": "no"}, InputTypeError, "search: expected a bool, got str"),
    ({"search": 1}, InputTypeError, "search: expected a bool, got int"),
    ({"mutuality": -0.1}, InputError, "mutuality: expected 0 <= mutuality <= 0.5 or None, got -0.1"),
    ({"mutuality": 0.6}, InputError, "mutuality: expected 0 <= mutuality <= 0.5 or None, got 0.6"),
    ({"mutuality": np.nan}, InputError, "mutuality: expected a finite number, got nan"),
    ({"mutuality": "half"}, InputTypeError, "mutuality: expected a real number, got str"),
    ({"relaxation": 0.9}, InputError, "relaxation: expected 1 <= relaxation < 2, got 0.9"),
    ({"relaxation": 2.0}, InputError, "relaxation: expected 1 <= relaxation < 2, got 2"),
    ({"relaxation": np.inf}, InputError, "relaxation: expected a finite number, got inf"),
    ({"relaxation": "1.5"}, InputTypeError, "relaxation: expected a real number, got str"),
    ({"relaxation": True}, InputTypeError, "relaxation: expected a real number, got bool"),
]


def check(call, error, message):
    with pytest.raises(AdaGMMError, match=re.compile(re.escape(message))) as caught:
        call()
    assert type(caught.value) is error
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, {InputTypeError: TypeError, DeviceError: RuntimeError}.get(error, ValueError))


def legacy(points, covariances=None):
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    if covariances is not None:
        cloud.covariances = o3d.utility.Matrix3dVector(covariances)
    return cloud


def tensor(points, covariances=None, dtype=core.float32):
    cloud = o3d.t.geometry.PointCloud(core.Tensor(np.asarray(points, float), dtype))
    if covariances is not None:
        cloud.point.covariances = core.Tensor(np.asarray(covariances, float), dtype)
    return cloud


# register_points


@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(("points", "error", "message"), POINT_CASES + ARRAY_CASES)
def test_points_as_arrays(side, points, error, message):
    arguments = {"source": POINTS[3], "target": POINTS[3], side: points}
    check(lambda: register_points(**arguments), error, f"{side}.{message}")


@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(("covariances", "error", "message"), COVARIANCE_CASES + ARRAY_COVARIANCE_CASES)
def test_covariances_as_arrays(side, covariances, error, message):
    arguments = {"source": POINTS[3], "target": POINTS[3], f"{side}_covariances": covariances}
    check(lambda: register_points(**arguments), error, f"{side}.{message}")


@pytest.mark.parametrize("side", ["source", "target"])
def test_arrays_with_a_mask(side):
    """What lies under a mask is no point; as a plain array it would count."""
    cloud = POINTS[3]
    clouds = {"source": cloud, "target": cloud}
    message = rf"^{side}\.{{}}: expected an array without a mask, {{}} masked; drop those points first$"
    masked = np.ma.masked_array(cloud, np.zeros(cloud.shape, bool))
    plain = register_points(cloud, cloud)
    whole = register_points(**(clouds | {side: masked}))
    np.testing.assert_array_equal(whole.transformation, plain.transformation)
    masked[4, 1] = np.ma.masked
    for points in (masked, [masked[i] for i in range(N)]):
        with pytest.raises(InputError, match=message.format("points", "1 entry is")):
            register_points(**(clouds | {side: points}))
    covariances = np.ma.masked_array(UNIT, np.arange(N)[:, None, None] * np.ones((3, 3)) == 7)
    with pytest.raises(InputError, match=message.format("covariances", "9 entries are")):
        register_points(cloud, cloud, **{f"{side}_covariances": covariances})


def test_masks_in_other_arguments():
    flags = np.ma.masked_array(np.zeros(N, bool), np.arange(N) == 3)
    with pytest.raises(InputError, match=r"^mask: expected an array without a mask, 1 entry is masked"):
        mark_outliers(UNIT, flags)
    init = np.ma.masked_array(np.eye(4), np.eye(4) == 1)
    with pytest.raises(InputError, match=r"^init: expected an array without a mask, 4 entries are masked"):
        register_points(POINTS[3], POINTS[3], init=init)


def test_points_of_the_plane_in_one_place():
    message = "source.points: all 60 points are in one place; a pose cannot be found"
    for place in (0.0, 1e6 + 0.1):
        check(lambda p=place: register_points(np.full((N, 2), p), POINTS[2]), DegenerateError, message)


def test_a_cloud_of_the_plane_against_one_of_space():
    check(
        lambda: register_points(POINTS[2], POINTS[3]),
        InputError,
        "target.points: expected shape (n, 2) as the source has, got (n, 3)",
    )
    check(
        lambda: register_points(POINTS[2], POINTS[2], init=np.eye(4)),
        InputError,
        "init: expected shape (3, 3), got (4, 4)",
    )


@pytest.mark.parametrize("rule", ["posterior", "nearest"])
@pytest.mark.parametrize(("init", "error", "message"), INIT_CASES)
def test_init_of_arrays(rule, init, error, message):
    method = TransformationEstimationForAdaptiveGMM(sigma_rule=rule)
    check(lambda: register_points(POINTS[3], POINTS[3], init=init, estimation_method=method), error, message)


@pytest.mark.parametrize(("device", "error", "message"), DEVICE_CASES)
def test_device_of_arrays(device, error, message):
    check(lambda: register_points(POINTS[3], POINTS[3], device=device), error, message)


@pytest.mark.parametrize(("name", "value", "error", "message"), SETTING_CASES)
def test_settings_of_arrays(name, value, error, message):
    check(lambda: register_points(POINTS[3], POINTS[3], **{name: value}), error, message)


# registration_adaptive_gmm


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(("points", "error", "message"), POINT_CASES)
def test_clouds(make, side, points, error, message):
    arguments = {"source": make(POINTS[3]), "target": make(POINTS[3]), side: make(points)}
    check(lambda: registration_adaptive_gmm(**arguments, max_correspondence_distance=0.1), error, f"{side}.{message}")


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize("side", ["source", "target"])
@pytest.mark.parametrize(("covariances", "error", "message"), COVARIANCE_CASES)
def test_covariances_of_clouds(make, side, covariances, error, message):
    arguments = {"source": make(POINTS[3]), "target": make(POINTS[3]), side: make(POINTS[3], covariances)}
    check(lambda: registration_adaptive_gmm(**arguments, max_correspondence_distance=0.1), error, f"{side}.{message}")


@pytest.mark.parametrize("make", [legacy, lambda points: tensor(points, dtype=core.float64)])
def test_clouds_whose_squares_overflow(make):
    check(
        lambda: registration_adaptive_gmm(make(1e200 * POINTS[3]), make(POINTS[3]), 0.1),
        InputError,
        "source.points: expected coordinates up to 1e+140, got ",
    )


def test_covariances_and_normals_that_do_not_match_the_points():
    good = legacy(POINTS[3])
    check(
        lambda: registration_adaptive_gmm(legacy(POINTS[3], UNIT[:7]), good, 0.1),
        InputError,
        "source.covariances: expected one for each of the 60 points, got 7",
    )
    good.normals = o3d.utility.Vector3dVector(POINTS[3][:7])
    check(
        lambda: registration_adaptive_gmm(good, legacy(POINTS[3]), 0.1),
        InputError,
        "source.normals: expected one for each of the 60 points, got 7",
    )
    flat = tensor(POINTS[3])
    flat.point.normals = core.Tensor(np.ones((N, 2), np.float32))
    check(
        lambda: registration_adaptive_gmm(tensor(POINTS[3]), flat, 0.1),
        InputError,
        "target.normals: expected shape (60, 3), got (60, 2)",
    )
    flat.point.covariances = core.Tensor(np.ones((N, 3), np.float32))
    for voxel_size in (-1.0, 0.1):
        check(
            lambda v=voxel_size: registration_adaptive_gmm(tensor(POINTS[3]), flat, 0.1, voxel_size=v),
            InputError,
            "target.covariances: expected shape (60, 3, 3), got (60, 3)",
        )


def test_things_that_are_no_clouds():
    good, good_tensor = legacy(POINTS[3]), tensor(POINTS[3])
    wanted = "expected an open3d.geometry.PointCloud or open3d.t.geometry.PointCloud, got"
    for value, name in ((None, "NoneType"), (POINTS[3], "ndarray; for arrays see register_points()")):
        check(lambda v=value: registration_adaptive_gmm(v, good, 0.1), InputTypeError, f"source: {wanted} {name}")
        check(
            lambda v=value: registration_adaptive_gmm(good_tensor, v, 0.1), InputTypeError, f"target: {wanted} {name}"
        )
    check(
        lambda: registration_adaptive_gmm(good, o3d.geometry.TriangleMesh(), 0.1),
        InputTypeError,
        f"target: {wanted} TriangleMesh",
    )
    check(
        lambda: registration_adaptive_gmm(good_tensor, good, 0.1),
        InputTypeError,
        "target: expected an open3d.t.geometry.PointCloud as the source is, got an open3d.geometry.PointCloud; "
        "convert it with open3d.t.geometry.PointCloud.from_legacy()",
    )
    check(
        lambda: registration_adaptive_gmm(good, good_tensor, 0.1),
        InputTypeError,
        "target: expected an open3d.geometry.PointCloud as the source is, got an open3d.t.geometry.PointCloud; "
        "convert it with .to_legacy()",
    )


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_clouds_among_arrays_are_told_the_other_door(kind):
    cloud = {"legacy": legacy, "tensor": tensor}[kind](POINTS[3])
    for name, pair in (("source", (cloud, POINTS[3])), ("target", (POINTS[3], cloud))):
        check(
            lambda pair=pair: register_points(*pair),
            InputTypeError,
            f"{name}: expected an array, got a PointCloud; see registration_adaptive_gmm()",
        )


def test_tensor_clouds_without_positions_or_of_another_dtype():
    good = tensor(POINTS[3])
    check(
        lambda: registration_adaptive_gmm(o3d.t.geometry.PointCloud(), good, 0.1),
        InputError,
        "source.point.positions: the cloud is empty; registration needs at least 3 points",
    )
    check(
        lambda: registration_adaptive_gmm(good, tensor(100 * POINTS[3], dtype=core.int32), 0.1),
        InputTypeError,
        "target.point.positions: expected Float32 or Float64, got Int32",
    )
    check(
        lambda: registration_adaptive_gmm(good, tensor(POINTS[3], dtype=core.float64), 0.1),
        InputTypeError,
        "target.point.positions: expected Float32 as the source has, got Float64; convert with .to()",
    )


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize(
    ("distance", "error", "message"),
    [
        (0.0, InputError, "expected a finite number > 0, got 0"),
        (-0.1, InputError, "expected a finite number > 0, got -0.1"),
        (np.nan, InputError, "expected a finite number > 0, got nan"),
        (-np.inf, InputError, "expected a finite number > 0, got -inf"),
        (None, InputTypeError, "expected a real number, got NoneType"),
        ("0.1", InputTypeError, "expected a real number, got str"),
        (True, InputTypeError, "expected a real number, got bool"),
        (
            [0.1, 0.05],
            InputTypeError,
            "expected a real number, got list; for several sizes see multi_scale_registration_adaptive_gmm()",
        ),
    ],
)
def test_distances(make, distance, error, message):
    clouds = make(POINTS[3]), make(POINTS[3])
    check(lambda: registration_adaptive_gmm(*clouds, distance), error, f"max_correspondence_distance: {message}")


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize(
    ("voxel_size", "error", "message"),
    [
        (np.nan, InputError, "voxel_size: expected a finite number, got nan"),
        (None, InputTypeError, "voxel_size: expected a real number, got NoneType"),
        ("0.1", InputTypeError, "voxel_size: expected a real number, got str"),
        (1e-12, InputError, "voxel_size: expected more than "),
        (100.0, DegenerateError, "source.points: 1 point cannot fix a pose; at least 3 are needed"),
    ],
)
def test_voxel_sizes(make, voxel_size, error, message):
    clouds = make(3.0 + np.abs(POINTS[3])), make(POINTS[3])
    check(lambda: registration_adaptive_gmm(*clouds, 0.1, voxel_size=voxel_size), error, message)


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize(("init", "error", "message"), INIT_CASES)
def test_init_of_clouds(make, init, error, message):
    clouds = make(POINTS[3]), make(POINTS[3])
    check(lambda: registration_adaptive_gmm(*clouds, 0.1, init), error, message)
    if isinstance(init, np.ndarray):
        start = core.Tensor(init)
        check(lambda: registration_adaptive_gmm(*clouds, 0.1, init_source_to_target=start), error, message)


@pytest.mark.parametrize("epsilon", [-0.1, np.nan, np.inf])
def test_the_thickness_of_surfaces(epsilon):
    method = reg.TransformationEstimationForGeneralizedICP(epsilon=epsilon)
    check(
        lambda: registration_adaptive_gmm(legacy(POINTS[3]), legacy(POINTS[3]), 0.1, np.eye(4), method),
        InputError,
        f"estimation_method.epsilon: expected a finite number >= 0, got {epsilon:g}",
    )


def test_no_iterations_where_no_pose_is_named():
    criteria = reg.ICPConvergenceCriteria(max_iteration=0)
    check(
        lambda: register_points(POINTS[3], POINTS[3], init="global", criteria=criteria),
        InputError,
        "criteria.max_iteration: expected at least 1 as init='global' names no pose, got 0",
    )


def test_init_given_twice():
    clouds = legacy(POINTS[3]), legacy(POINTS[3])
    check(
        lambda: registration_adaptive_gmm(*clouds, 0.1, np.eye(4), init_source_to_target=np.eye(4)),
        InputError,
        "init: given twice, as init and as init_source_to_target; give one",
    )


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize(("device", "error", "message"), DEVICE_CASES)
def test_device_of_clouds(make, device, error, message):
    check(lambda: registration_adaptive_gmm(make(POINTS[3]), make(POINTS[3]), 0.1, device=device), error, message)


@pytest.mark.parametrize("make", [legacy, tensor])
@pytest.mark.parametrize(("name", "value", "error", "message"), SETTING_CASES)
def test_settings_of_clouds(make, name, value, error, message):
    clouds = make(POINTS[3]), make(POINTS[3])
    check(lambda: registration_adaptive_gmm(*clouds, 0.1, **{name: value}), error, message)


# options


@pytest.mark.parametrize(("options", "error", "message"), OPTION_CASES)
def test_options(options, error, message):
    check(lambda: TransformationEstimationForAdaptiveGMM(**options), error, message)


def test_options_are_frozen_and_compare_by_value():
    options = TransformationEstimationForAdaptiveGMM(relaxation=1.5)
    with pytest.raises(AttributeError):
        options.relaxation = 1.0
    assert options == TransformationEstimationForAdaptiveGMM(relaxation=1.5)
    assert hash(options) != hash(TransformationEstimationForAdaptiveGMM())
