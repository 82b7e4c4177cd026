"""What the evaluation says to bad input: the exact line."""

import numpy as np
import pytest

from adagmm_o3d import evaluation
from adagmm_o3d.errors import AdaGMMError, InputError, InputTypeError

POINTS = np.random.default_rng(0).normal(size=(5, 3))
MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
BAD_POSES = [
    (np.eye(5), InputError, "expected shape (3 or 4, 3 or 4), got (5, 5)"),
    (np.eye(4)[:3], InputError, "expected a square matrix, got shape (3, 4)"),
    (np.full((4, 4), np.nan), InputError, "expected finite numbers, got nan at index (0, 0); drop such entries first"),
    (
        2.0 * np.eye(4),
        InputError,
        "expected a homogeneous matrix with last row (0, 0, 0, 1), got (0, 0, 0, 2); "
        "embed a rotation R as eye(D + 1) with [:D, :D] = R",
    ),
    (MIRROR, InputError, "expected a rotation, got determinant -1 and RᵀR − I up to 0; see project_to_rotation()"),
    (
        np.diag([1.01, 1.0, 1.0, 1.0]),
        InputError,
        "expected a rotation, got determinant 1.01 and RᵀR − I up to 0.0201; see project_to_rotation()",
    ),
    (None, InputTypeError, "expected an array of real numbers, got NoneType"),
]
POSE_ERRORS = [
    evaluation.pose_errors,
    evaluation.rotation_error_frobenius,
    evaluation.rotation_error_deg,
    evaluation.translation_error,
]
FITS = [
    lambda s, t, d, T: evaluation.overlap_ratio(s, t, T, d),
    evaluation.evaluate_registration,
    evaluation.information_matrix,
]


def check(call, error, message):
    with pytest.raises(error) as caught:
        call()
    assert str(caught.value) == message
    assert isinstance(caught.value, AdaGMMError)


@pytest.mark.parametrize("function", POSE_ERRORS)
@pytest.mark.parametrize("pose, error, message", BAD_POSES)
def test_poses_that_are_none(function, pose, error, message):
    check(lambda: function(pose, np.eye(4)), error, f"T_true: {message}")
    check(lambda: function(np.eye(4), pose), error, f"T_est: {message}")


@pytest.mark.parametrize("function", POSE_ERRORS)
def test_a_pose_of_the_plane_against_one_of_space(function):
    check(lambda: function(np.eye(4), np.eye(3)), InputError, "T_est: expected shape (4, 4) like T_true, got (3, 3)")


@pytest.mark.parametrize("function", FITS)
@pytest.mark.parametrize("pose, error, message", BAD_POSES)
def test_clouds_with_a_pose_that_is_none(function, pose, error, message):
    check(lambda: function(POINTS, POINTS, 0.1, pose), error, f"transformation: {message}")


@pytest.mark.parametrize("function", FITS)
@pytest.mark.parametrize(
    "source, target, pose, error, message",
    [
        (POINTS[:0], POINTS, np.eye(4), InputError, "source_points: expected at least one point, got none"),
        (POINTS, POINTS[:0], np.eye(4), InputError, "target_points: expected at least one point, got none"),
        (POINTS[:, :1], POINTS, np.eye(4), InputError, "source_points: expected shape (M, 2 or 3), got (5, 1)"),
        (POINTS, POINTS[:, :2], np.eye(4), InputError, "target_points: expected shape (N, 3), got (5, 2)"),
        (
            POINTS[:, :2],
            POINTS[:, :2],
            np.eye(4),
            InputError,
            "transformation: expected shape (3, 3) for points in 2D, got (4, 4)",
        ),
        (
            POINTS,
            np.full_like(POINTS, np.nan),
            np.eye(4),
            InputError,
            "target_points: expected at least one point, got none",
        ),
        (
            POINTS / np.abs(POINTS).max() * 1e200,
            POINTS,
            np.eye(4),
            InputError,
            "source_points: expected coordinates up to 1e+140, got 1e+200; rescale",
        ),
        (
            POINTS,
            POINTS / np.abs(POINTS).max() * 1e200,
            np.eye(4),
            InputError,
            "target_points: expected coordinates up to 1e+140, got 1e+200; rescale",
        ),
        (
            POINTS,
            POINTS,
            np.eye(4) + 1e200 * np.outer(np.eye(4)[0], np.eye(4)[3]),
            InputError,
            "transformation: expected coordinates up to 1e+140, got 1e+200; rescale",
        ),
        ([["a"]], POINTS, np.eye(4), InputTypeError, "source_points: expected an array of real numbers, got list"),
    ],
)
def test_clouds(function, source, target, pose, error, message):
    check(lambda: function(source, target, 0.1, pose), error, message)


@pytest.mark.parametrize("distance", [0.0, -1.0, np.nan, -np.inf])
def test_distances(distance):
    message = f"expected a finite number > 0, got {distance:g}"
    for function in FITS[1:]:
        check(
            lambda f=function: f(POINTS, POINTS, distance, np.eye(4)),
            InputError,
            f"max_correspondence_distance: {message}",
        )
    check(lambda: evaluation.overlap_ratio(POINTS, POINTS, np.eye(4), distance), InputError, f"distance: {message}")
