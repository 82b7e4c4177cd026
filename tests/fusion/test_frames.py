"""Frames, intrinsics and rigid transformations are checked where they enter."""

import numpy as np
import pytest

from adagmm_fusion.frames.rgbd import (
    PinholeIntrinsics,
    RGBDFrame,
    RGBDPair,
    checked_rigid_transformation,
)
from adagmm_o3d.errors import AdaGMMError, InputError, InputTypeError

INTRINSICS = PinholeIntrinsics(8, 6, 10.0, 11.0, 3.5, 2.5)


def make_frame(**changes):
    values = {
        "name": "frame 0",
        "color": np.zeros((6, 8, 3), np.uint8),
        "depth": np.full((6, 8), 1500, np.uint16),
        "intrinsics": INTRINSICS,
        "depth_scale": 1000.0,
        "sensor": "left",
    }
    return RGBDFrame(**(values | changes))


def rotation_about(axis, angle):
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(np.asarray(axis) * angle).as_matrix()
    T[:3, 3] = (0.3, -0.2, 1.5)
    return T


def test_intrinsics_matrix_projects_as_documented():
    u, v, w = INTRINSICS.matrix() @ (0.5, -0.25, 2.0)
    assert u / w == pytest.approx(10.0 * 0.5 / 2.0 + 3.5, rel=1e-12, abs=1e-12)
    assert v / w == pytest.approx(11.0 * -0.25 / 2.0 + 2.5, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    "changes, word",
    [
        ({"width": 0}, "width"),
        ({"width": 8.5}, "width"),
        ({"height": True}, "height"),
        ({"fx": 0.0}, "fx"),
        ({"fy": -1.0}, "fy"),
        ({"cx": float("nan")}, "cx"),
        ({"cy": "left"}, "cy"),
        ({"distortion": (0.1, 0.2)}, "distortion"),
        ({"distortion": (0.1, 0.2, np.inf, 0.0)}, r"distortion\[2\]"),
    ],
)
def test_intrinsics_refuse_bad_values_and_name_them(changes, word):
    good = {"width": 8, "height": 6, "fx": 10.0, "fy": 11.0, "cx": 3.5, "cy": 2.5}
    with pytest.raises(InputError, match=word) as caught:
        PinholeIntrinsics(**(good | changes))
    assert "\n" not in str(caught.value)


def test_only_nonzero_coefficients_count_as_distortion():
    assert not PinholeIntrinsics(8, 6, 10, 10, 3, 2, (0.0,) * 5).distorted
    assert PinholeIntrinsics(8, 6, 10, 10, 3, 2, (0.0, 0.0, 1e-3, 0.0)).distorted


def test_depth_becomes_metres_and_missing_becomes_nan():
    depth = np.full((6, 8), 1500, np.uint16)
    depth[0, 0] = 0
    metres = make_frame(depth=depth).depth_m()
    assert metres.dtype == np.float32
    assert np.isnan(metres[0, 0])
    np.testing.assert_allclose(metres[1:], 1.5, rtol=1e-7, atol=0)
    floats = np.full((6, 8), 2.0, np.float64)
    floats[0, :4] = (0.0, -1.0, np.inf, np.nan)
    metres = make_frame(depth=floats, depth_scale=1.0).depth_m()
    assert np.isnan(metres[0, :4]).all() and np.isfinite(metres[0, 4:]).all()


@pytest.mark.parametrize(
    "changes, error, word",
    [
        ({"depth": np.zeros((6, 8), np.uint8)}, InputTypeError, "8-bit"),
        ({"depth": np.zeros((6, 8), np.int32)}, InputTypeError, "int32"),
        ({"depth": np.zeros((6, 8, 3), np.uint16)}, InputError, "one channel"),
        ({"depth": np.zeros((6, 7), np.uint16)}, InputError, "register the depth"),
        ({"color": np.zeros((6, 8, 3), np.float32)}, InputTypeError, "uint8"),
        ({"color": np.zeros((6, 8), np.uint8)}, InputError, r"\(H, W, 3\)"),
        ({"depth_scale": 0.0}, InputError, "depth_scale"),
        ({"depth_scale": float("inf")}, InputError, "depth_scale"),
        ({"timestamp": float("nan")}, InputError, "timestamp"),
        ({"intrinsics": np.eye(3)}, InputTypeError, "PinholeIntrinsics"),
        ({"intrinsics": PinholeIntrinsics(9, 6, 10, 10, 3, 2)}, InputError, "9x6"),
    ],
)
def test_frame_refuses_bad_values_in_one_line(changes, error, word):
    with pytest.raises(error, match=word) as caught:
        make_frame(**changes)
    assert isinstance(caught.value, AdaGMMError)
    assert str(caught.value).startswith("frame 0: ") and "\n" not in str(caught.value)


def test_rounded_rotation_is_cleaned_and_exact_one_keeps_its_bits():
    T = rotation_about((0.6, 0.0, 0.8), 0.7)
    assert np.array_equal(checked_rigid_transformation(T, "T"), T)
    cleaned = checked_rigid_transformation(np.round(T, 4), "T")
    np.testing.assert_allclose(cleaned[:3, :3] @ cleaned[:3, :3].T, np.eye(3), rtol=0, atol=1e-14)
    np.testing.assert_allclose(cleaned, T, rtol=0, atol=2e-4)


@pytest.mark.parametrize(
    "T, word",
    [
        (np.eye(3), "shape"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "not a rotation"),
        (np.diag([1.1, 1.1, 1.1, 1.0]), "not a rotation"),
        (np.diag([0.0, 0.0, 0.0, 1.0]), "not a rotation: inf from one, determinant 0;"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
        (np.full((4, 4), np.nan), "finite"),
        (np.zeros((4, 4)), "last row"),
        ("pose", "matrix of numbers"),
    ],
)
def test_pair_refuses_what_is_not_rigid(T, word):
    with pytest.raises(InputError, match=word):
        RGBDPair("a-b", make_frame(), make_frame(), T, 0)


def test_pair_accepts_no_ground_truth():
    assert RGBDPair("a-b", make_frame(), make_frame(), None, 3).T_target_source is None


def test_a_transposed_transformation_is_named():
    T = np.eye(4)
    T[:3, 3] = 1.0, 2.0, 3.0
    with pytest.raises(InputError, match=r"^pose: looks transposed, 0 0 0 1 is its last column"):
        checked_rigid_transformation(T.T, "pose")
