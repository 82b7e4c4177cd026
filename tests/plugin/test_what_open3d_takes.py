"""Input of another form that Open3D takes is taken, and makes no difference."""

import re
from decimal import Decimal
from fractions import Fraction

import numpy as np
import open3d as o3d
import pytest
from shapes import bumpy, move

from adagmm_o3d import TransformationEstimationForAdaptiveGMM, evaluation, lie, register_points
from adagmm_o3d.arguments import distance_limit, real_number, unit_vectors, whole_number
from adagmm_o3d.errors import InputError, InputTypeError
from adagmm_o3d.options import Criteria, check_criteria
from adagmm_o3d.registration import registration_adaptive_gmm
from adagmm_o3d.uncertainty.surface import stand_in_covariances

POSE = lie.se_exp([0.1, -0.2, 0.15, 0.1, 0.05, -0.1])
TARGET = bumpy(np.random.default_rng(0), 300, 3)
SOURCE = move(TARGET, np.linalg.inv(POSE))


def legacy(points):
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def rounded(size=1e-16):
    pose = POSE.copy()
    pose[3] += size * np.array([1.0, -1.0, 1.0, 1.0])
    return pose


# Poses


@pytest.mark.parametrize("pose", [rounded(3e-16), rounded(5e-7), np.linalg.pinv(np.linalg.pinv(POSE))])
def test_a_last_row_may_be_rounded(pose):
    np.testing.assert_array_equal(lie.split(pose)[0], pose[:3, :3])
    assert evaluation.pose_errors(POSE, pose).translation < 1e-12
    assert register_points(SOURCE, TARGET, init=pose, criteria=Criteria(1e-3, 0)).iterations == 0


def test_a_last_row_that_is_more_than_rounded_is_shown_as_it_is():
    message = "init: expected a homogeneous matrix with last row (0, 0, 0, 1), got (2e-06, -2e-06, 2e-06, 1.000002)"
    with pytest.raises(InputError, match=re.escape(message)):
        register_points(SOURCE, TARGET, init=rounded(2e-6))


@pytest.mark.parametrize("dtype", [bool, object, np.int8])
def test_a_pose_of_other_numbers(dtype):
    expected = register_points(SOURCE, TARGET, init=np.eye(4))
    result = register_points(SOURCE, TARGET, init=np.eye(4).astype(dtype))
    np.testing.assert_array_equal(result.transformations, expected.transformations)
    np.testing.assert_array_equal(lie.se_inverse(np.eye(4).astype(dtype)), np.eye(4))


def test_objects_are_numbers_where_each_of_them_is_one():
    assert lie.so_exp([Decimal(0), Fraction(0), 0]).tolist() == np.eye(3).tolist()
    for wrong in ("0", None, 1j):
        with pytest.raises(InputTypeError, match=r"^omega: expected an array of real numbers, got list$"):
            lie.so_exp([Decimal(0), wrong, 0])
    with pytest.raises(InputError, match=r"^omega: expected finite numbers, got inf at index \(1,\)"):
        lie.so_exp([Decimal(0), 10**400, 0])


# Normals


@pytest.mark.parametrize("dtype", ["int32", "uint8", "bool"])
@pytest.mark.parametrize("distance", [0.25, np.inf])
def test_normals_of_whole_numbers(dtype, distance):
    normals = np.tile(np.array([0, 1, 1], dtype), (len(SOURCE), 1))
    results = []
    for kind in (normals, normals.astype(np.float32)):
        clouds = [o3d.t.geometry.PointCloud(o3d.core.Tensor(points)) for points in (SOURCE, TARGET)]
        for cloud in clouds:
            cloud.point.normals = o3d.core.Tensor(kind)
        results.append(registration_adaptive_gmm(*clouds, distance))
    np.testing.assert_array_equal(results[0].transformation.numpy(), results[1].transformation.numpy())
    assert results[0].inlier_rmse == results[1].inlier_rmse and results[0].fitness == results[1].fitness


# Single numbers

HALVES = [0.5, np.float32(0.5), np.float16(0.5), np.array(0.5), Decimal("0.5"), Fraction(1, 2), np.array(0.5, object)]


@pytest.mark.parametrize("value", HALVES, ids=repr)
def test_one_real_number_of_any_kind(value):
    for read in (real_number("x", value), distance_limit("x", value)):
        assert read == 0.5 and type(read) is float


@pytest.mark.parametrize("value", [np.inf, np.float32(np.inf), np.array(np.inf), Decimal("Infinity")], ids=repr)
def test_no_limit_of_any_kind(value):
    assert distance_limit("x", value) == np.inf
    with pytest.raises(InputError, match=r"^x: expected a finite number, got inf$"):
        real_number("x", value)


@pytest.mark.parametrize("read", [real_number, distance_limit])
@pytest.mark.parametrize(
    ("value", "error", "got"),
    [
        (10**400, InputError, "one too large for a float"),
        (Fraction(10**400), InputError, "one too large for a float"),
        (True, InputTypeError, "bool"),
        (np.array(True), InputTypeError, "an array of dtype bool"),
        (np.array("1"), InputTypeError, "an array of dtype <U1"),
        (np.array([0.5]), InputTypeError, "an array of shape (1,)"),
        (np.eye(2), InputTypeError, "an array of shape (2, 2)"),
        (1j, InputTypeError, "complex"),
        (np.complex64(1), InputTypeError, "complex64"),
        ("0.5", InputTypeError, "str"),
        (None, InputTypeError, "NoneType"),
        (Decimal("sNaN"), InputTypeError, "Decimal"),
    ],
)
def test_what_is_not_one_real_number(read, value, error, got):
    with pytest.raises(error, match=rf"^x: expected a .*number.*, got {re.escape(got)}$"):
        read("x", value)


def test_one_integer_of_any_kind():
    assert [whole_number("x", value, minimum=0) for value in (7, np.int8(7), np.array(7))] == [7, 7, 7]
    for wrong in (7.0, np.array(7.0), np.array([7]), True, np.True_, np.array(True), "7", Decimal(7)):
        with pytest.raises(InputTypeError, match=r"^x: expected an integer, got "):
            whole_number("x", wrong, minimum=0)


def test_settings_of_other_numbers():
    plain = registration_adaptive_gmm(legacy(SOURCE), legacy(TARGET), 0.25, voxel_size=0.125)
    other = registration_adaptive_gmm(
        legacy(SOURCE),
        legacy(TARGET),
        np.array(0.25),
        voxel_size=Decimal("0.125"),
        criteria=Criteria(Decimal("0.001"), np.array(200)),
        estimation_method=TransformationEstimationForAdaptiveGMM(
            mutuality=np.array(0.0), relaxation=Decimal(1), search=np.True_, color=np.False_
        ),
    )
    np.testing.assert_array_equal(other.transformation, plain.transformation)
    assert other.inlier_rmse == plain.inlier_rmse
    read = check_criteria(Criteria(Fraction(1, 2), np.int64(3)))
    assert (type(read.relative_rmse), type(read.max_iteration)) == (float, int)


def test_options_are_kept_as_they_were_read():
    given = TransformationEstimationForAdaptiveGMM(search=np.False_, color=np.True_, mutuality=Fraction(1, 4))
    assert given == TransformationEstimationForAdaptiveGMM(search=False, color=True, mutuality=0.25)
    assert given.search is False and given.color is True and type(given.mutuality) is float


# Directions


@pytest.mark.parametrize("length", [5e-324, 1e-310, 1e-200, 1e-5, 1e5, 1e200, 1e308])
@pytest.mark.filterwarnings("error")
def test_directions_of_any_length(length):
    assert TransformationEstimationForAdaptiveGMM(gravity=(0, -length, 0)).gravity == (0.0, -1.0, 0.0)
    assert unit_vectors("normals", [[length, 0.0, 0.0]], ("N", 3)).tolist() == [[1.0, 0.0, 0.0]]
    along_x = np.tile([length, 0.0, 0.0], (len(TARGET), 1))
    np.testing.assert_array_equal(stand_in_covariances(TARGET, along_x), stand_in_covariances(TARGET, np.sign(along_x)))


def test_directions_keep_their_bits():
    """The length that divides is that of before, to the last bit."""
    vectors = np.random.default_rng(0).normal(size=(1000, 3)) * 1e3
    np.testing.assert_array_equal(
        unit_vectors("normals", vectors, ("N", 3)), vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    )
    for vector in vectors[:200]:
        kept = TransformationEstimationForAdaptiveGMM(gravity=tuple(vector)).gravity
        assert kept == tuple((vector / np.linalg.norm(vector)).tolist())
