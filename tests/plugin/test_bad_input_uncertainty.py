"""What the covariance models say to bad input: the exact line, and an error that ordinary `except` clauses catch."""

import numpy as np
import pytest

from adagmm_o3d.errors import AdaGMMError, DegenerateError, InputError, InputTypeError
from adagmm_o3d.uncertainty import (
    KinectUncertainty,
    estimate_kinect_covariances,
    estimate_kinect_surface_covariances,
    estimate_lidar_covariances,
    estimate_nguyen_covariances,
    estimate_surface_covariances,
    mark_outliers,
)

POINTS = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 2.0], [0.0, 0.5, 3.0], [0.5, 0.5, 4.0]])
NORMALS = np.tile([0.0, 0.0, -1.0], (4, 1))
COVARIANCES = np.tile(np.eye(3), (4, 1, 1))


def put(array, index, value):
    changed = np.array(array)
    changed[index] = value
    return changed


def check(call, error, message):
    with pytest.raises(error) as caught:
        call()
    assert str(caught.value) == message
    assert isinstance(caught.value, AdaGMMError)
    assert isinstance(caught.value, TypeError if error is InputTypeError else ValueError)


VIEWED = [
    (POINTS[:, :2], NORMALS, InputError, "points: expected shape (N, 3), got (4, 2)"),
    (POINTS[0], NORMALS, InputError, "points: expected shape (N, 3), got (3,)"),
    (POINTS, NORMALS[:3], InputError, "normals: expected (4, 3) to match the points, got (3, 3)"),
    (POINTS, NORMALS[:, :2], InputError, "normals: expected shape (N, 3), got (4, 2)"),
    (
        put(POINTS, (2, 1), np.nan),
        NORMALS,
        InputError,
        "points: expected finite numbers, got nan at index (2, 1); drop such entries first",
    ),
    (
        POINTS,
        put(NORMALS, (3, 0), np.inf),
        InputError,
        "normals: expected finite numbers, got inf at index (3, 0); drop such entries first",
    ),
    (
        POINTS,
        put(NORMALS, 1, 0.0),
        InputError,
        "normals: expected non-zero vectors, got length 0 at row 1; drop that point first",
    ),
    (
        put(POINTS, (1, 2), -0.5),
        NORMALS,
        InputError,
        "points: expected z > 0 in the camera frame, got z = -0.5 at row 1; "
        "estimate covariances before moving the cloud out of its camera's frame",
    ),
    (
        1000.0 * POINTS,
        NORMALS,
        InputError,
        "points: expected metres, at most 100 from the camera, got z = 1000 at row 0; divide by the depth scale first",
    ),
    ("cloud", NORMALS, InputTypeError, "points: expected an array of real numbers, got str"),
    (
        POINTS.astype(complex),
        NORMALS,
        InputTypeError,
        "points: expected an array of real numbers, got dtype complex128",
    ),
    ([[0.0, 0.0, 1.0], [1.0]], NORMALS, InputTypeError, "points: expected an array of real numbers, got a ragged list"),
    (POINTS, None, InputTypeError, "normals: expected an array of real numbers, got NoneType"),
]


TOO_LARGE = put(POINTS, (1, 0), 1e200)


@pytest.mark.parametrize(
    "estimate",
    [
        estimate_surface_covariances,
        lambda points: estimate_surface_covariances(points[:, :2]),
        lambda points: estimate_surface_covariances(points, NORMALS),
        lambda points: estimate_kinect_covariances(points, NORMALS),
        lambda points: estimate_kinect_surface_covariances(points, NORMALS, 525.0),
        lambda points: estimate_nguyen_covariances(points, NORMALS, 525.0),
        estimate_lidar_covariances,
    ],
)
@pytest.mark.filterwarnings("error")
def test_coordinates_whose_squares_overflow(estimate):
    check(lambda: estimate(TOO_LARGE), InputError, "points: expected coordinates up to 1e+140, got 1e+200; rescale")


@pytest.mark.filterwarnings("error")
def test_an_origin_whose_square_overflows():
    message = "origin: expected coordinates up to 1e+140, got 1e+200; rescale"
    check(lambda: estimate_lidar_covariances(POINTS, origin=(1e200, 0.0, 0.0)), InputError, message)


@pytest.mark.parametrize("points, normals, error, message", VIEWED)
def test_points_and_normals_of_the_kinect_model(points, normals, error, message):
    check(lambda: estimate_kinect_covariances(points, normals), error, message)


@pytest.mark.parametrize("estimate", [estimate_nguyen_covariances, estimate_kinect_surface_covariances])
@pytest.mark.parametrize("points, normals, error, message", VIEWED)
def test_points_and_normals_of_the_metric_models(points, normals, error, message, estimate):
    check(lambda: estimate(points, normals, 525.0), error, message)


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda: KinectUncertainty(w1=-1.0), InputError, "w1: expected a finite number >= 0, got -1"),
        (lambda: KinectUncertainty(w2=np.nan), InputError, "w2: expected a finite number >= 0, got nan"),
        (lambda: KinectUncertainty(w2="0.3"), InputTypeError, "w2: expected a real number, got str"),
        (
            lambda: KinectUncertainty.from_reference(0.5),
            InputError,
            "reference: expected a finite number >= 1, got 0.5",
        ),
        (lambda: KinectUncertainty.from_reference(True), InputTypeError, "reference: expected a real number, got bool"),
        (
            lambda: estimate_kinect_covariances(POINTS, NORMALS, model=(1.0, 1.0)),
            InputTypeError,
            "model: expected a KinectUncertainty, got tuple",
        ),
        (
            lambda: estimate_kinect_covariances(POINTS, NORMALS, model=KinectUncertainty(w1=1.0, w2=100.0)),
            InputError,
            "model: expected w1 + w2 z up to 200, got 401; use smaller weights",
        ),
    ],
)
def test_kinect_weights(call, error, message):
    check(call, error, message)


@pytest.mark.parametrize(
    "focal_length, error, message",
    [
        (0.0, InputError, "focal_length: expected a finite number > 0, got 0"),
        (np.inf, InputError, "focal_length: expected a finite number > 0, got inf"),
        ((525.0, -1.0), InputError, "focal_length: expected fx, fy > 0 in pixels, got (525, -1)"),
        ((525.0, 525.0, 320.0), InputError, "focal_length: expected shape (2,), got (3,)"),
        ("525", InputTypeError, "focal_length: expected a real number, got str"),
    ],
)
@pytest.mark.parametrize("estimate", [estimate_nguyen_covariances, estimate_kinect_surface_covariances])
def test_focal_length(focal_length, error, message, estimate):
    check(lambda: estimate(POINTS, NORMALS, focal_length), error, message)


@pytest.mark.parametrize(
    "call, error, message",
    [
        (
            lambda: estimate_surface_covariances(np.ones((5, 4))),
            InputError,
            "points: expected shape (N, 2 or 3), got (5, 4)",
        ),
        (
            lambda: estimate_surface_covariances(POINTS, NORMALS[:, :2]),
            InputError,
            "normals: expected shape (N, 3), got (4, 2)",
        ),
        (
            lambda: estimate_surface_covariances(POINTS, NORMALS[:2]),
            InputError,
            "normals: expected (4, 3) to match the points, got (2, 3)",
        ),
        (
            lambda: estimate_surface_covariances(POINTS[:3]),
            DegenerateError,
            "points: expected more than 3 to estimate normals from, got 3; pass normals or covariances",
        ),
        (
            lambda: estimate_surface_covariances(np.empty((0, 2))),
            DegenerateError,
            "points: expected more than 2 to estimate normals from, got 0; pass normals or covariances",
        ),
        (lambda: estimate_surface_covariances(POINTS, knn=3), InputError, "knn: expected an integer >= 4, got 3"),
        (lambda: estimate_surface_covariances(POINTS, knn=20.0), InputTypeError, "knn: expected an integer, got float"),
        (
            lambda: estimate_surface_covariances(POINTS, epsilon=0.0),
            InputError,
            "epsilon: expected a finite number > 0, got 0",
        ),
        (
            lambda: estimate_surface_covariances(POINTS, epsilon=2.0),
            InputError,
            "epsilon: expected at most 1, got 2; it is the variance across the surface",
        ),
    ],
)
def test_surface(call, error, message):
    check(call, error, message)


@pytest.mark.parametrize(
    "call, error, message",
    [
        (
            lambda: estimate_lidar_covariances(POINTS[:, :2]),
            InputError,
            "points: expected shape (N, 3), got (4, 2)",
        ),
        (
            lambda: estimate_lidar_covariances(np.full((2, 3), np.nan)),
            InputError,
            "points: expected finite numbers, got nan at index (0, 0); drop such entries first",
        ),
        (
            lambda: estimate_lidar_covariances([[1.0, 0.0, 0.0], [0.0, 0.0, 2500.0]]),
            InputError,
            "points: expected metres, at most 1000 from the sensor, got 2500 at row 1; divide by the unit first",
        ),
        (lambda: estimate_lidar_covariances(POINTS, origin=[0.0]), InputError, "origin: expected shape (3,), got (1,)"),
        (
            lambda: estimate_lidar_covariances(POINTS, range_noise=-0.1),
            InputError,
            "range_noise: expected a finite number >= 0, got -0.1",
        ),
        (
            lambda: estimate_lidar_covariances(POINTS, beam_noise="1"),
            InputTypeError,
            "beam_noise: expected a real number, got str",
        ),
        (
            lambda: estimate_lidar_covariances(POINTS, extent=0.0),
            InputError,
            "extent: expected a finite number > 0, got 0",
        ),
    ],
)
def test_lidar(call, error, message):
    check(call, error, message)


@pytest.mark.parametrize(
    "call, error, message",
    [
        (
            lambda: mark_outliers(COVARIANCES[0], np.zeros(4, bool)),
            InputError,
            "covariances: expected shape (N, 2 or 3, 2 or 3), got (3, 3)",
        ),
        (
            lambda: mark_outliers(np.ones((4, 2, 3)), np.zeros(4, bool)),
            InputError,
            "covariances: expected (N, 2, 2) or (N, 3, 3), got (4, 2, 3)",
        ),
        (lambda: mark_outliers(COVARIANCES, np.zeros(3, bool)), InputError, "mask: expected shape (4,), got (3,)"),
        (
            lambda: mark_outliers(COVARIANCES, [0, 2]),
            InputTypeError,
            "mask: expected booleans, got dtype int64; index lists are not masks",
        ),
        (
            lambda: mark_outliers(COVARIANCES, np.zeros(4, bool), scale=0.5),
            InputError,
            "scale: expected a finite number >= 1, got 0.5",
        ),
        (
            lambda: mark_outliers(COVARIANCES, np.zeros(4, bool), scale=None),
            InputTypeError,
            "scale: expected a real number, got NoneType",
        ),
    ],
)
def test_outliers(call, error, message):
    check(call, error, message)
