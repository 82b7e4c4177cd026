"""The Xtion reader, and the registration of depth to colour that it needs."""

import cv2
import numpy as np
import pytest
import scipy.io
from depth_scene import camera_pose, render, write_xtion
from scipy.spatial.transform import Rotation

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames.depth_registration import register_depth
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration
from adagmm_o3d.lie import se_inverse

COLOR = PinholeIntrinsics(160, 120, 134.0, 133.0, 78.0, 61.0)
DEPTH = PinholeIntrinsics(160, 120, 142.0, 143.0, 79.0, 59.0)
T_COLOR_DEPTH = np.eye(4)
T_COLOR_DEPTH[:3, :3] = Rotation.from_euler("xyz", (0.5, -1.0, 0.3), degrees=True).as_matrix()
T_COLOR_DEPTH[:3, 3] = (-0.026, 0.001, 0.002)
POSES = [camera_pose(-10.0), camera_pose(12.0, (0.1, 0.4, 1.3))]


@pytest.fixture
def xtion(tmp_path):
    write_xtion(tmp_path, POSES, COLOR, DEPTH, T_COLOR_DEPTH)
    return tmp_path


def test_what_is_read_back(xtion):
    recording = open_recording(xtion)
    assert recording.format == "xtion" and recording.sensors == ("camera1", "camera2")
    assert [recording.pair_name(i) for i in range(2)] == ["2_camera2_to_camera1", "11_camera2_to_camera1"]
    pair = recording[0]
    np.testing.assert_allclose(pair.T_target_source, se_inverse(POSES[0]) @ POSES[1], rtol=0, atol=1e-12)
    for frame, pose in ((pair.target, POSES[0]), (pair.source, POSES[1])):
        color, depth = render(COLOR, pose)
        assert np.array_equal(frame.color, color) and frame.intrinsics == COLOR
        measured = frame.depth_m()
        assert np.isfinite(measured).mean() > 0.85
        # Half a pixel off on slanted walls, and a pixel seen by one camera only at the ball's outline.
        error = np.abs(measured - depth)[np.isfinite(measured)]
        assert np.median(error) < 0.006 and (error > 0.05).mean() < 0.02


def test_registration_keeps_the_nearer_surface():
    depth = np.full((120, 160), 3000, np.uint16)
    depth[40:80, 60:100] = 1000
    baseline = np.eye(4)
    baseline[0, 3] = -0.1
    registered = register_depth(depth, DEPTH, DEPTH, baseline, 1000.0)
    near = np.abs(registered - 1000) < 1
    # The near square moves by f b / z = 14.2 pixels to the left, and hides what lies behind it there.
    assert near[40:80, 46:86].mean() == 1.0 and near.sum() == 40 * 40
    assert set(np.unique(registered)) <= {0.0, 1000.0, 3000.0}


def test_registration_into_a_finer_image_leaves_no_gaps():
    fine = PinholeIntrinsics(400, 300, 355.0, 357.5, 197.5, 147.5)
    registered = register_depth(np.full((120, 160), 2000, np.uint16), DEPTH, fine, np.eye(4), 1000.0)
    inner = registered[10:-10, 10:-10]
    np.testing.assert_allclose(inner, 2000.0, rtol=1e-6, atol=0)
    coarse = PinholeIntrinsics(80, 60, 71.0, 71.5, 39.5, 29.5)
    assert (register_depth(np.full((120, 160), 2000, np.uint16), DEPTH, coarse, np.eye(4), 1000.0) > 0).all()


def test_registration_of_nothing_and_of_what_is_behind():
    assert not register_depth(np.zeros((120, 160), np.uint16), DEPTH, COLOR, T_COLOR_DEPTH, 1000.0).any()
    behind = np.eye(4)
    behind[2, 3] = -5.0
    assert not register_depth(np.full((120, 160), 2000, np.uint16), DEPTH, COLOR, behind, 1000.0).any()


def test_without_reference_there_is_no_truth_and_a_rig_gives_it(xtion):
    (xtion / "images/T_cam1_to_cam2_reference.txt").unlink()
    assert open_recording(xtion)[0].T_target_source is None
    sensors = {f"camera{i}": SensorCalibration(f"camera{i}", COLOR, 1000.0, POSES[i - 1]) for i in (1, 2)}
    pair = open_recording(xtion, rig=Rig("two", sensors))[0]
    np.testing.assert_allclose(pair.T_target_source, se_inverse(POSES[0]) @ POSES[1], rtol=0, atol=1e-12)


def spoil(path, **variables):
    scipy.io.savemat(path, variables)


@pytest.mark.parametrize(
    "file, damage, match",
    [
        ("images/depth2_2.mat", lambda p: p.unlink(), r"depth2_2\.mat: the file is missing"),
        ("images/depth2_2.mat", lambda p: p.write_bytes(p.read_bytes()[:300]), "cut off"),
        ("images/depth2_2.mat", lambda p: p.write_bytes(b""), "not a MATLAB file of level 5"),
        ("images/depth2_2.mat", lambda p: spoil(p, depth_array={"a": 1.0}), "got a structure"),
        ("images/depth2_2.mat", lambda p: spoil(p, other=1), "no variable 'depth_array'"),
        ("images/depth2_2.mat", lambda p: spoil(p, depth_array=np.zeros((3, 3))), r"expected \(H, W\) uint16"),
        (
            "images/rgb_image2_2.png",
            lambda p: cv2.imwrite(str(p), np.zeros((9, 9, 3), np.uint8)),
            "expected 160x120 pix",
        ),
        ("images/rgb_image2_2.png", lambda p: p.unlink(), r"rgb_image2_2\.png: the image is missing"),
    ],
)
def test_damaged_files(xtion, file, damage, match):
    damage(xtion / file)
    with pytest.raises(RecordingError, match=match) as caught:
        open_recording(xtion)[0]
    assert str(caught.value).startswith(str(xtion)) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "values, match",
    [
        ({"cam_params": {"Kdepth": np.eye(3)}}, r"cam_params: expected Kdepth, Krgb, R \(3x3\) and T \(3\)"),
        ({"cam_params": 3.0}, r"cam_params: expected Kdepth, Krgb, R \(3x3\) and T \(3\)"),
        ({"other": 3.0}, "no variable 'cam_params'"),
    ],
)
def test_damaged_calibration(xtion, values, match):
    scipy.io.savemat(xtion / "cameraparametersAsus.mat", values)
    with pytest.raises(RecordingError, match=match):
        open_recording(xtion)


def test_calibration_must_be_rigid(xtion):
    values = {"Kdepth": DEPTH.matrix(), "Krgb": COLOR.matrix(), "R": 2 * np.eye(3), "T": np.zeros(3)}
    scipy.io.savemat(xtion / "cameraparametersAsus.mat", {"cam_params": values})
    with pytest.raises(RecordingError, match=r"cameraparametersAsus\.mat: cam_params R, T: .*not a rotation"):
        open_recording(xtion)


def test_one_sensor_is_not_enough(xtion):
    for path in xtion.glob("images/depth2_*.mat"):
        path.unlink()
    with pytest.raises(RecordingError, match="expected depth images of two sensors, got 1"):
        open_recording(xtion)
    for path in xtion.glob("images/depth1_*.mat"):
        path.unlink()
    with pytest.raises(RecordingError, match=r"expected one folder with depth1_N\.mat files, got none"):
        open_recording(xtion)
