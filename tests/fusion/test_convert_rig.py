"""`adagmm-fusion convert-rig`: what ROS and OpenCV wrote about two cameras is the same rig in our file."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from adagmm_fusion.cli import main
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.rigs.rig import load_rig
from adagmm_o3d.lie import se_inverse

LEFT = PinholeIntrinsics(640, 480, 525.0, 527.0, 322.0, 238.0, (0.08, -0.15, 0.001, -0.0007, 0.02))
RIGHT = PinholeIntrinsics(640, 480, 540.0, 538.0, 315.0, 245.0, (-0.05, 0.06, 0.0, 0.001, 0.0))
T_LEFT_RIGHT = np.eye(4)
T_LEFT_RIGHT[:3, :3] = Rotation.from_euler("xyz", (3.0, -12.0, 2.0), degrees=True).as_matrix()
T_LEFT_RIGHT[:3, 3] = (0.35, 0.02, 0.06)


def rectified():
    """R1, R2, P1, P2 as OpenCV and, with it, ROS make them."""
    T = se_inverse(T_LEFT_RIGHT)
    cameras = [part for k in (LEFT, RIGHT) for part in (k.matrix(), np.array(k.distortion))]
    return cv2.stereoRectify(*cameras, (640, 480), T[:3, :3], T[:3, 3:])[:4]


def ros(path, k, R=None, P=None, *, model="plumb_bob"):
    def block(name, matrix):
        rows, columns = matrix.shape
        return f"{name}:\n  rows: {rows}\n  cols: {columns}\n  data: {matrix.ravel().tolist()}\n"

    text = f"image_width: {k.width}\nimage_height: {k.height}\ncamera_name: {path.stem}\n"
    text += block("camera_matrix", k.matrix()) + f"distortion_model: {model}\n"
    text += block("distortion_coefficients", np.array([k.distortion]))
    if R is not None:
        text += block("rectification_matrix", R) + block("projection_matrix", P)
    path.write_text(text)


def opencv(path, **values):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()


def convert(folder, *arguments) -> int:
    return main(["convert-rig", *map(str, arguments), "--output", str(folder / "rig.yaml")])


def is_ours(rig, *, atol=1e-9):
    assert list(rig.sensors) == ["left", "right"]
    assert (rig.sensors["left"].intrinsics, rig.sensors["right"].intrinsics) == (LEFT, RIGHT)
    np.testing.assert_array_equal(rig.sensors["left"].T_rig_sensor, np.eye(4))
    np.testing.assert_allclose(rig.sensors["right"].T_rig_sensor, T_LEFT_RIGHT, rtol=0, atol=atol)


def test_a_ros_stereo_pair(tmp_path, capsys):
    R1, R2, P1, P2 = rectified()
    ros(tmp_path / "l.yaml", LEFT, R1, P1)
    ros(tmp_path / "r.yaml", RIGHT, R2, P2)
    assert convert(tmp_path, f"left={tmp_path / 'l.yaml'}", f"right={tmp_path / 'r.yaml'}") == 0
    assert capsys.readouterr().out == f"{tmp_path / 'rig.yaml'}: left, right\n"
    is_ours(load_rig(tmp_path / "rig.yaml"))


def test_ros_messages_as_they_are_printed(tmp_path):
    for name, k in (("left", LEFT), ("right", RIGHT)):
        text = f"header: {{seq: 1}}\nheight: {k.height}\nwidth: {k.width}\ndistortion_model: plumb_bob\n"
        text += f"d: {list(k.distortion)}\nk: {k.matrix().ravel().tolist()}\n"
        (tmp_path / f"{name}.yaml").write_text(text)
    assert convert(tmp_path, *(f"{n}={tmp_path / n}.yaml" for n in ("left", "right")), "--depth-scale", "5000") == 0
    rig = load_rig(tmp_path / "rig.yaml")
    assert rig.sensors["right"].intrinsics == RIGHT and rig.sensors["right"].T_rig_sensor is None
    assert rig.sensors["left"].depth_scale == 5000.0


def test_ros_cameras_calibrated_one_by_one_have_no_known_pose(tmp_path, capsys):
    for name, k in (("left", LEFT), ("right", RIGHT)):
        ros(tmp_path / f"{name}.yaml", k, np.eye(3), np.column_stack((k.matrix(), np.zeros(3))))
    assert convert(tmp_path, *(f"{n}={tmp_path / n}.yaml" for n in ("left", "right"))) == 0
    assert capsys.readouterr().out.endswith("; the pose of right is unknown\n")
    assert load_rig(tmp_path / "rig.yaml").sensors["right"].T_rig_sensor is None


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_opencv_files_of_each_camera_and_the_stereo_pose_in_millimetres(tmp_path, suffix):
    for name, k in (("left", LEFT), ("right", RIGHT)):
        opencv(
            tmp_path / f"{name}.{suffix}",
            image_width=k.width,
            image_height=k.height,
            camera_matrix=k.matrix(),
            distortion_coefficients=np.array(k.distortion),
        )
    T = se_inverse(T_LEFT_RIGHT)
    opencv(tmp_path / f"extrinsics.{suffix}", R=T[:3, :3], T=1000.0 * T[:3, 3])
    sensors = [f"{name}={tmp_path / name}.{suffix}" for name in ("left", "right")]
    assert convert(tmp_path, *sensors, "--stereo", tmp_path / f"extrinsics.{suffix}", "--length-unit", "mm") == 0
    is_ours(load_rig(tmp_path / "rig.yaml"))


def test_an_opencv_stereo_file_without_the_image_size(tmp_path, capsys):
    path, T = tmp_path / "stereo.yml", se_inverse(T_LEFT_RIGHT)
    cameras = {"M1": LEFT.matrix(), "D1": np.array(LEFT.distortion), "M2": RIGHT.matrix()}
    opencv(path, **cameras, D2=np.array(RIGHT.distortion), R=T[:3, :3], T=T[:3, 3])
    arguments = [f"left={path}", f"right={path}", "--stereo", path]
    assert convert(tmp_path, *arguments) == 1
    assert capsys.readouterr().err == f"adagmm-fusion: {path}: the image size is not in it; give it with --size\n"
    assert convert(tmp_path, *arguments, "--size", "640x480") == 0
    is_ours(load_rig(tmp_path / "rig.yaml"))


def test_what_cannot_be_used_is_one_line(tmp_path, capsys):
    good, fisheye, empty, mirrored, short = (
        tmp_path / f"{n}.yaml" for n in ("good", "fish", "empty", "mirror", "short")
    )
    ros(good, LEFT)
    ros(fisheye, LEFT, model="equidistant")
    empty.write_text("camera_name: left\n")
    ros(short, LEFT)
    short.write_text(short.read_text().replace("525.0, ", ""))
    opencv(mirrored, R=np.diag([1.0, 1.0, -1.0]), T=np.zeros(3))
    (tmp_path / "broken.xml").write_text("<?xml version='1.0'?><opencv_storage><camera_matrix>")
    for arguments, message in (
        (["left=nowhere.yaml"], "nowhere.yaml: cannot be read"),
        (["left"], "SENSOR=FILE: left: there is no such file"),
        ([f"left={good}", f"left={good}"], "SENSOR=FILE: expected different names"),
        ([f"left={fisheye}"], "expected plumb_bob or rational_polynomial, got equidistant"),
        ([f"left={empty}"], "there is no image_width"),
        ([f"left={short}"], "expected 9 numbers, got 8"),
        ([f"left={tmp_path / 'broken.xml'}"], "broken.xml: "),
        (
            [f"left={mirrored}", "--size", "640x480"],
            "expected a camera matrix called camera_matrix, cameraMatrix, K or M1",
        ),
        ([f"left={good}", "--stereo", mirrored], "--stereo: expected two sensors, got 1"),
        ([f"left={good}", f"right={good}", "--stereo", mirrored], "not a rotation"),
        ([f"left={good}", f"right={good}", "--stereo", tmp_path / "no.yml"], "no.yml: "),
        ([f"l/ft={good}"], "sensor name: expected letters"),
    ):
        assert convert(tmp_path, *arguments) == 1, arguments
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and message in err
    assert not (tmp_path / "rig.yaml").exists()


DIALECTS = ("distortionCoefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeff", "D", "distortion")


@pytest.mark.parametrize("name", DIALECTS)
def test_distortion_is_kept_whatever_its_name(tmp_path, name):
    """iai_kinect2 writes distortionCoefficients, OpenCV's samples several others."""
    opencv(tmp_path / "color.yaml", cameraMatrix=LEFT.matrix(), **{name: np.array(LEFT.distortion)})
    assert convert(tmp_path, f"color={tmp_path / 'color.yaml'}", "--size", "640x480") == 0
    assert load_rig(tmp_path / "rig.yaml").sensors["color"].intrinsics == LEFT


@pytest.mark.parametrize("name", ["fisheyeDistortion", "lens_distortion_model", "kc", "k1", "dist9x"])
def test_distortion_of_a_name_that_is_not_known_is_refused(tmp_path, name, capsys):
    opencv(tmp_path / "color.yaml", cameraMatrix=LEFT.matrix(), **{name: np.array(LEFT.distortion)})
    assert convert(tmp_path, f"color={tmp_path / 'color.yaml'}", "--size", "640x480") == 1
    assert f"color.yaml: {name}: is it the lens distortion?" in capsys.readouterr().err
    assert not (tmp_path / "rig.yaml").exists()


def test_the_other_cameras_distortion_is_no_riddle(tmp_path):
    opencv(tmp_path / "stereo.yml", M1=LEFT.matrix(), M2=RIGHT.matrix(), D2=np.array(RIGHT.distortion))
    assert convert(tmp_path, f"left={tmp_path / 'stereo.yml'}", "--size", "640x480") == 0
    assert load_rig(tmp_path / "rig.yaml").sensors["left"].intrinsics.distortion == ()


def test_a_pose_as_iai_kinect2_writes_it(tmp_path):
    T = se_inverse(T_LEFT_RIGHT)
    for name, k in (("left", LEFT), ("right", RIGHT)):
        opencv(tmp_path / f"{name}.yaml", cameraMatrix=k.matrix(), distortionCoefficients=np.array(k.distortion))
    opencv(tmp_path / "calib_pose.yaml", rotation=T[:3, :3], translation=T[:3, 3])
    sensors = [f"{name}={tmp_path / name}.yaml" for name in ("left", "right")]
    assert convert(tmp_path, *sensors, "--stereo", tmp_path / "calib_pose.yaml", "--size", "640x480") == 0
    is_ours(load_rig(tmp_path / "rig.yaml"))


@pytest.mark.parametrize(
    ("K", "match"),
    [
        ("[[525, 0, 322], [0, 527, 238], [0, 0, 1]]", None),
        ("[525, 527, 322, 238]", None),
        ("[[525, 0, 322], [0, 527], [0, 0, 1]]", "expected a 3x3 or 4x4 matrix or fx fy cx cy, got 8 numbers"),
        ('"525"', "OpenCV cannot read it, or a matrix in it has no numbers"),
        ('["a", 0, 0]', "expected 3 finite numbers"),
    ],
)
def test_a_camera_matrix_of_nested_lists(tmp_path, K, match, capsys):
    (tmp_path / "k.json").write_text(f'{{"image_width": 640, "image_height": 480, "K": {K}}}')
    assert convert(tmp_path, f"left={tmp_path / 'k.json'}") == (0 if match is None else 1)
    if match is None:
        assert load_rig(tmp_path / "rig.yaml").sensors["left"].intrinsics.matrix().tolist() == LEFT.matrix().tolist()
    else:
        err = capsys.readouterr().err
        assert match in err and "e+308" not in err


def test_a_camera_matrix_of_nested_lists_in_opencvs_yaml(tmp_path):
    text = "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n"
    (tmp_path / "k.yaml").write_text(text + "K: [ [525., 0., 322.], [0., 527., 238.], [0., 0., 1.] ]\n")
    assert convert(tmp_path, f"left={tmp_path / 'k.yaml'}") == 0
    assert load_rig(tmp_path / "rig.yaml").sensors["left"].intrinsics.matrix().tolist() == LEFT.matrix().tolist()


def test_plain_json_as_realsense_and_orbbec_tools_write_it(tmp_path, capsys):
    values = {"fx": 525.0, "fy": 527.0, "ppx": 322.0, "ppy": 238.0, "model": "Brown Conrady", "coeffs": [0.0] * 5}
    (tmp_path / "k.json").write_text(json.dumps({"color": values}))
    assert convert(tmp_path, f"left={tmp_path / 'k.json'}") == 1
    assert "the image size is not in it" in capsys.readouterr().err
    assert convert(tmp_path, f"left={tmp_path / 'k.json'}", "--size", "640x480") == 0
    assert load_rig(tmp_path / "rig.yaml").sensors["left"].intrinsics.matrix().tolist() == LEFT.matrix().tolist()
    lens = {"k1": 0.08, "k2": -0.15, "p1": 0.001, "p2": -0.0007, "k3": 0.02}
    (tmp_path / "k.json").write_text(json.dumps({"rgbIntrinsic": values | lens | {"width": 640, "height": 480}}))
    assert convert(tmp_path, f"left={tmp_path / 'k.json'}") == 0
    assert load_rig(tmp_path / "rig.yaml").sensors["left"].intrinsics == LEFT
    (tmp_path / "k.json").write_text(json.dumps(values | {"width": 640, "height": 480, "coeffs": [0.1, 0, 0, 0, 0]}))
    assert convert(tmp_path, f"left={tmp_path / 'k.json'}") == 1
    assert "coeffs: this lens distortion is not understood" in capsys.readouterr().err


TWO = {
    "depthIntrinsic": {"fx": 380.0, "fy": 381.0, "cx": 320.0, "cy": 200.0, "width": 640, "height": 400},
    "rgbIntrinsic": {"fx": 525.0, "fy": 527.0, "cx": 322.0, "cy": 238.0, "width": 640, "height": 480},
    "rgbDistortion": {"k1": 0.08, "k2": -0.15, "p1": 0.001, "p2": -0.0007, "k3": 0.02},
    "depthDistortion": {"k1": 0.5, "k2": 0.0, "p1": 0.0, "p2": 0.0, "k3": 0.0},
    "transform": {"rot": np.eye(3).ravel().tolist(), "trans": [-25.0, 0.0, 0.0]},
}
DEPTH_CAMERA = PinholeIntrinsics(640, 400, 380.0, 381.0, 320.0, 200.0, (0.5, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(("sensor", "meant"), [("color", LEFT), ("left", LEFT), ("depth", DEPTH_CAMERA)])
def test_of_two_cameras_in_one_json_the_fields_are_not_mixed(tmp_path, capsys, sensor, meant):
    (tmp_path / "both.json").write_text(json.dumps(TWO))
    assert convert(tmp_path, f"{sensor}={tmp_path / 'both.json'}") == 0
    assert load_rig(tmp_path / "rig.yaml").sensors[sensor].intrinsics == meant
    err = capsys.readouterr().err
    assert err == (
        ""
        if sensor != "left"
        else f"adagmm-fusion: {tmp_path / 'both.json'}: it has a colour and a depth camera; left is the colour camera\n"
    )


@pytest.mark.parametrize(
    ("stated", "fisheye"),
    [
        ({"distortion_model": "equidistant"}, True),
        ({"camera_model": "KannalaBrandt8"}, True),
        ({"fisheye_model": 1}, True),
        ({"fisheye_model": 0}, False),
        ({"model": "distortion.inverse_brown_conrady"}, True),
        ({"model": "RS2_DISTORTION_BROWN_CONRADY"}, False),
        ({"camera_model": "D435i"}, False),
        ({"distortion_model": "polynomial of Smith"}, True),
    ],
)
@pytest.mark.parametrize("suffix", ["json", "yml"])
def test_coefficients_of_another_lens_model_are_refused(tmp_path, capsys, suffix, stated, fisheye):
    path = tmp_path / f"k.{suffix}"
    if suffix == "json":
        values = {"fx": 525.0, "fy": 527.0, "cx": 322.0, "cy": 238.0, "width": 640, "height": 480}
        path.write_text(json.dumps(values | {"distortion": LEFT.distortion} | stated))
    else:
        lens = {"camera_matrix": LEFT.matrix(), "D": np.array(LEFT.distortion)}
        opencv(path, **lens, image_width=640, image_height=480, **stated)
    assert convert(tmp_path, f"left={path}") == (1 if fisheye else 0)
    if fisheye:
        name = next(iter(stated)).replace("_", "")
        assert f"{path}: {name}: expected plumb_bob or rational_polynomial, got " in capsys.readouterr().err
    else:
        assert load_rig(tmp_path / "rig.yaml").sensors["left"].intrinsics == LEFT


@pytest.mark.parametrize(
    "stated, taken", [({"distortion_model": "equidistant"}, True), ({"camera_model": "KB8"}, False)]
)
@pytest.mark.parametrize("kind", ["json", "opencv", "ros"])
def test_a_lens_without_coefficients_is_undistorted_unless_the_camera_is_a_fisheye(tmp_path, kind, stated, taken):
    """Of the three files one was taken."""
    path = tmp_path / f"k.{'json' if kind == 'json' else 'yaml'}"
    if kind == "json":
        values = {"fx": 525.0, "fy": 527.0, "cx": 322.0, "cy": 238.0, "width": 640, "height": 480}
        path.write_text(json.dumps(values | {"D": [0.0] * 4} | stated))
    elif kind == "opencv":
        opencv(path, camera_matrix=LEFT.matrix(), D=np.zeros(4), image_width=640, image_height=480, **stated)
    else:
        ros(path, replace(LEFT, distortion=(0.0,) * 4))
        lines = [line for line in path.read_text().splitlines() if not line.startswith("distortion_model")]
        path.write_text("\n".join([*lines, *(f"{name}: {value}" for name, value in stated.items())]) + "\n")
    assert convert(tmp_path, f"left={path}") == (0 if taken else 1)
    if taken:
        assert load_rig(tmp_path / "rig.yaml").sensors["left"].intrinsics == replace(LEFT, distortion=())


def test_the_depth_unit_of_a_calibration_counts_unless_an_option_says_it(tmp_path):
    values = {"fx": 525.0, "fy": 527.0, "cx": 322.0, "cy": 238.0, "width": 640, "height": 480}
    (tmp_path / "k.json").write_text(json.dumps(values | {"depth_units": 0.00025}))
    ros(tmp_path / "k.yaml", LEFT)
    (tmp_path / "k.yaml").write_text((tmp_path / "k.yaml").read_text() + "depth_scale: 5000.0\n")
    for name, options, scale in (
        ("k.json", [], 4000.0),
        ("k.yaml", [], 5000.0),
        ("k.json", ["--depth-scale", 100], 100),
    ):
        assert convert(tmp_path, f"left={tmp_path / name}", *options) == 0
        assert load_rig(tmp_path / "rig.yaml").sensors["left"].depth_scale == scale


def open3d_rig(path, T):
    intrinsic = {"width": 640, "height": 480, "intrinsic_matrix": LEFT.matrix().T.ravel().tolist()}
    cameras = [{"extrinsic": se_inverse(pose).T.ravel().tolist(), "intrinsic": intrinsic} for pose in (np.eye(4), T)]
    path.write_text(json.dumps({"class_name": "PinholeCameraTrajectory", "parameters": cameras}))
    return [path]


def kalibr_rig(path, T):
    lens = "  camera_model: pinhole\n  intrinsics: [525.0, 525.0, 319.5, 239.5]\n  distortion_model: radtan\n"
    lens += "  distortion_coeffs: [0, 0, 0, 0]\n  resolution: [640, 480]\n"
    path.write_text(f"cam0:\n{lens}cam1:\n{lens}  T_cn_cnm1: {se_inverse(T).tolist()}\n")
    return [path]


def stereo_rig(path, T):
    ros(path.parent / "one.yaml", LEFT)
    opencv(path, R=se_inverse(T)[:3, :3], T=se_inverse(T)[:3, 3])
    return [f"left={path.parent / 'one.yaml'}", f"right={path.parent / 'one.yaml'}", "--stereo", path]


@pytest.mark.parametrize(
    ("name", "write"), [("o.json", open3d_rig), ("camchain.yaml", kalibr_rig), ("stereo.yml", stereo_rig)]
)
def test_a_rig_in_millimetres_is_noticed(tmp_path, capsys, name, write):
    T = T_LEFT_RIGHT.copy()
    T[:3, 3] *= 1000.0
    arguments = write(tmp_path / name, T)
    assert convert(tmp_path, *arguments) == 0
    err = capsys.readouterr().err
    assert "are 356 m apart, which looks like another unit taken for metres; try --length-unit cm (3.56 m) or " in err
    assert err.endswith(" or --length-unit mm (0.356 m)\n")
    assert convert(tmp_path, *arguments, "--length-unit", "mm") == 0
    assert capsys.readouterr().err == ""
    second = list(load_rig(tmp_path / "rig.yaml").sensors.values())[1]
    np.testing.assert_allclose(second.T_rig_sensor, T_LEFT_RIGHT, rtol=0, atol=1e-9)
