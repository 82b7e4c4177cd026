"""Rotations and rigid transformations: group laws, sampled near the singular angles 0 and π too."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from adagmm_o3d import lie
from adagmm_o3d.errors import InputError, InputTypeError

ANGLES = [0.0, 1e-300, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 0.3, 2.5, math.pi - 1e-3, math.pi - 1e-7, math.pi - 1e-10]
DIMENSIONS = [2, 3]

angles = st.one_of(
    st.sampled_from(ANGLES),
    st.floats(0.0, math.pi - 1e-9),
    st.floats(-14.0, -1.0).map(lambda e: 10.0**e),
    st.floats(-9.0, -1.0).map(lambda e: math.pi - 10.0**e),
)
coordinates = st.floats(-10.0, 10.0)
unit_vectors = (
    st.tuples(coordinates, coordinates, coordinates)
    .filter(lambda v: np.linalg.norm(v) > 1e-3)
    .map(lambda v: np.array(v) / np.linalg.norm(v))
)


@st.composite
def tangents(draw, dimension):
    angle = draw(angles)
    omega = np.array([angle * draw(st.sampled_from([-1.0, 1.0]))]) if dimension == 2 else angle * draw(unit_vectors)
    return np.concatenate([omega, [draw(coordinates) for _ in range(dimension)]])


def algebra(xi):
    """The matrix of a tangent vector, written out independently of `lie`."""
    if len(xi) == 3:
        return np.array([[0, -xi[0], xi[1]], [xi[0], 0, xi[2]], [0, 0, 0]])
    x, y, z = xi[:3]
    return np.array([[0, -z, y, xi[3]], [z, 0, -x, xi[4]], [-y, x, 0, xi[5]], [0, 0, 0, 0]])


@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(data=st.data())
def test_exp_is_the_matrix_exponential(dimension, data):
    xi = data.draw(tangents(dimension))
    np.testing.assert_allclose(lie.se_exp(xi), expm(algebra(xi)), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(data=st.data())
def test_log_inverts_exp(dimension, data):
    xi = data.draw(tangents(dimension))
    np.testing.assert_allclose(lie.se_log(lie.se_exp(xi)), xi, rtol=1e-9, atol=2e-13)


@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(data=st.data())
def test_exp_inverts_log_of_a_product(dimension, data):
    transformation = lie.se_exp(data.draw(tangents(dimension))) @ lie.se_exp(data.draw(tangents(dimension)))
    xi = lie.se_log(transformation)
    assert np.linalg.norm(xi[:-dimension]) <= math.pi * (1.0 + 1e-15)
    np.testing.assert_allclose(lie.se_exp(xi), transformation, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(data=st.data())
def test_adjoint_moves_a_perturbation_from_right_to_left(dimension, data):
    transformation, delta = lie.se_exp(data.draw(tangents(dimension))), data.draw(tangents(dimension))
    right = transformation @ lie.se_exp(delta)
    left = lie.se_exp(lie.se_adjoint(transformation) @ delta) @ transformation
    np.testing.assert_allclose(left, right, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(data=st.data())
def test_adjoint_is_a_homomorphism(dimension, data):
    a, b = (lie.se_exp(data.draw(tangents(dimension))) for _ in range(2))
    np.testing.assert_allclose(lie.se_adjoint(a @ b), lie.se_adjoint(a) @ lie.se_adjoint(b), rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(data=st.data())
def test_inverse_is_the_exponential_of_the_negative(dimension, data):
    xi = data.draw(tangents(dimension))
    inverse = lie.se_inverse(lie.se_exp(xi))
    np.testing.assert_allclose(inverse, lie.se_exp(-xi), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(inverse @ lie.se_exp(xi), np.eye(dimension + 1), rtol=0.0, atol=1e-13)


@given(axis=unit_vectors, exponent=st.floats(-300.0, -1.0))
def test_tiny_rotations_keep_every_digit(axis, exponent):
    omega = 10.0**exponent * axis
    np.testing.assert_allclose(lie.so_log(lie.so_exp(omega)), omega, rtol=0.0, atol=1e-14 * 10.0**exponent)


@given(axis=unit_vectors)
def test_a_half_turn_gives_one_of_its_two_vectors(axis):
    omega = lie.so_log(lie.so_exp(math.pi * axis))
    assert np.linalg.norm(omega) == pytest.approx(math.pi, rel=1e-14, abs=0.0)
    assert abs(omega @ axis) == pytest.approx(math.pi, rel=1e-12, abs=0.0)


def test_a_half_turn_of_the_plane():
    np.testing.assert_allclose(np.abs(lie.so_log(-np.eye(2))), [math.pi], rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("axis", np.eye(3))
def test_exact_half_turns_about_the_axes(axis):
    rotation = 2.0 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_allclose(np.abs(lie.so_log(rotation)), math.pi * axis, rtol=1e-15, atol=0.0)


@given(axis=unit_vectors, vector=unit_vectors)
def test_hat_is_the_cross_product(axis, vector):
    np.testing.assert_allclose(lie.hat(axis) @ vector, np.cross(axis, vector), rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(lie.vee(lie.hat(axis)), axis)


@pytest.mark.parametrize("dimension", [2, 3])
def test_how_points_move_with_a_perturbation(dimension):
    rng = np.random.default_rng(dimension)
    points, turns = rng.normal(size=(5, dimension)), 2 * dimension - 3
    moves = lie.moved_by(points)
    for j in range(turns + dimension):
        step = 1e-7 * np.eye(turns + dimension)[j]
        T = lie.se_exp(step)
        moved = points @ T[:dimension, :dimension].T + T[:dimension, dimension]
        np.testing.assert_allclose(moves[:, :, j], (moved - points) / 1e-7, rtol=0, atol=1e-6)


def test_hat_of_the_plane_turns_x_into_y():
    np.testing.assert_array_equal(lie.hat([2.0]) @ [1.0, 0.0], [0.0, 2.0])
    np.testing.assert_array_equal(lie.vee(lie.hat([2.0])), [2.0])


def test_a_left_perturbation_moves_points_by_omega_cross_p_plus_v():
    rng = np.random.default_rng(3)
    transformation = lie.se_exp(rng.normal(size=6))
    point, delta = rng.normal(size=3), 1e-6 * rng.normal(size=6)
    before = transformation[:3, :3] @ point + transformation[:3, 3]
    moved = lie.se_exp(delta) @ transformation
    after = moved[:3, :3] @ point + moved[:3, 3]
    np.testing.assert_allclose(after - before, np.cross(delta[:3], before) + delta[3:], rtol=1e-4, atol=1e-11)


@pytest.mark.parametrize("dimension", DIMENSIONS)
@given(data=st.data())
def test_projection_returns_rotations_unchanged(dimension, data):
    rotation = lie.se_exp(data.draw(tangents(dimension)))[:-1, :-1]
    np.testing.assert_allclose(lie.project_to_rotation(rotation), rotation, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("dimension", DIMENSIONS)
@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_projection_is_the_nearest_rotation(dimension, seed):
    rng = np.random.default_rng(seed)
    matrix = lie.so_exp(rng.normal(size=1 if dimension == 2 else 3)) + 0.3 * rng.normal(size=(dimension, dimension))
    nearest = lie.project_to_rotation(matrix)
    assert lie.is_rotation(nearest, tolerance=1e-12)
    best = np.linalg.norm(matrix - nearest)
    for _ in range(20):
        other = lie.so_exp(rng.normal(scale=rng.choice([1e-3, 0.1, 2.0]), size=1 if dimension == 2 else 3)) @ nearest
        assert np.linalg.norm(matrix - other) >= best - 1e-12


@pytest.mark.parametrize(
    "matrix, expected",
    [
        (np.eye(3), True),
        (np.eye(2), True),
        (np.diag([1.0, 1.0, -1.0]), False),
        (np.diag([1.0, -1.0]), False),
        (1.001 * np.eye(3), False),
        (np.full((3, 3), np.nan), False),
        (lie.so_exp([0.3, -2.0, 1.0]).astype(np.float32), True),
    ],
)
def test_is_rotation(matrix, expected):
    assert lie.is_rotation(matrix) is expected


@pytest.mark.parametrize(
    "call, error, message",
    [
        (lambda: lie.hat([1.0, 2.0]), InputError, "omega: expected shape (1 or 3,), got (2,)"),
        (
            lambda: lie.so_exp([0.0, np.nan, 0.0]),
            InputError,
            "omega: expected finite numbers, got nan at index (1,); drop such entries first",
        ),
        (lambda: lie.se_exp(np.zeros(4)), InputError, "tangent: expected shape (3 or 6,), got (4,)"),
        (lambda: lie.se_exp("pose"), InputTypeError, "tangent: expected an array of real numbers, got str"),
        (
            lambda: lie.so_log(np.diag([1.0, 1.0, -1.0])),
            InputError,
            "rotation: expected a rotation, got determinant -1 and RᵀR − I up to 0; see project_to_rotation()",
        ),
        (
            lambda: lie.se_log(np.diag([1.1, 1.0, 1.0, 1.0])),
            InputError,
            "transformation: expected a rotation, got determinant 1.1 and RᵀR − I up to 0.21; "
            "see project_to_rotation()",
        ),
        (
            lambda: lie.se_inverse(np.diag([1.0, 1.0, 1.0, 2.0])),
            InputError,
            "transformation: expected a homogeneous matrix with last row (0, 0, 0, 1), got (0, 0, 0, 2); "
            "embed a rotation R as eye(D + 1) with [:D, :D] = R",
        ),
        (
            lambda: lie.se_adjoint(np.zeros((3, 4))),
            InputError,
            "transformation: expected a square matrix, got shape (3, 4)",
        ),
        (lambda: lie.is_rotation(np.eye(4)), InputError, "matrix: expected shape (2 or 3, 2 or 3), got (4, 4)"),
        (
            lambda: lie.is_rotation(np.eye(3), tolerance=0.0),
            InputError,
            "tolerance: expected a finite number > 0, got 0",
        ),
        (
            lambda: lie.project_to_rotation(np.diag([1.0, 0.0, 0.0])),
            InputError,
            "matrix: expected a matrix with one nearest rotation, got singular values (1, 0, 0) and determinant 0; "
            "is it a rotation at all?",
        ),
        (
            lambda: lie.project_to_rotation(np.diag([1.0, 1.0, -1.0])),
            InputError,
            "matrix: expected a matrix with one nearest rotation, got singular values (1, 1, 1) and determinant -1; "
            "is it a rotation at all?",
        ),
    ],
)
def test_bad_input_gets_one_clear_line(call, error, message):
    with pytest.raises(error) as caught:
        call()
    assert str(caught.value) == message
