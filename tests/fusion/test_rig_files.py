"""`adagmm-fusion convert-rig FILE`: whole rigs as other programs write them are the same rig in our file."""

import json

import numpy as np
import pytest
import scipy.io
from ros_bags import write_ros_bag
from scipy.spatial.transform import Rotation

from adagmm_fusion.cli import main
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.rigs.rig import load_rig
from adagmm_fusion.rigs.rig_files import read_rig_file
from adagmm_o3d.errors import AdaGMMError
from adagmm_o3d.lie import se_inverse

LEFT = PinholeIntrinsics(640, 480, 525.0, 527.0, 322.0, 238.0, (0.08, -0.15, 0.001, -0.0007))
RIGHT = PinholeIntrinsics(640, 480, 540.0, 538.0, 315.0, 245.0, (-0.05, 0.06, 0.0, 0.001))
THIRD = PinholeIntrinsics(320, 240, 270.0, 270.0, 160.0, 120.0)
CAMERAS = (LEFT, RIGHT, THIRD)


def pose(angles, position):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), position
    return T


T_WORLD = [pose((5, 20, 0), (1.0, 2.0, 0.5)), pose((3, -12, 2), (1.35, 2.02, 0.56)), pose((0, 60, 0), (0.2, 0.1, 3.0))]
# In the first camera's frame.
POSES = [se_inverse(T_WORLD[0]) @ T for T in T_WORLD]


def convert(folder, *arguments) -> int:
    return main(["convert-rig", *map(str, arguments), "--output", str(folder / "rig.yaml")])


def is_the_rig(folder, names, cameras=CAMERAS, poses=POSES, *, atol=1e-6):
    rig = load_rig(folder / "rig.yaml")
    assert tuple(rig.sensors) == names
    for sensor, intrinsics, T in zip(rig.sensors.values(), cameras, poses, strict=False):
        ours = sensor.intrinsics
        np.testing.assert_allclose(ours.matrix(), intrinsics.matrix(), rtol=0, atol=atol)
        assert (ours.width, ours.height) == (intrinsics.width, intrinsics.height)
        np.testing.assert_allclose(ours.distortion[:4], intrinsics.distortion[:4], rtol=0, atol=atol)
        np.testing.assert_allclose(sensor.T_rig_sensor, T, rtol=0, atol=atol)


def camchain(path, lens="radtan"):
    text = ""
    for i, k in enumerate(CAMERAS):
        text += f"cam{i}:\n  cam_overlaps: [1]\n  camera_model: pinhole\n"
        text += f"  distortion_coeffs: {list(k.distortion or (0.0,) * 4)}\n  distortion_model: {lens}\n"
        text += f"  intrinsics: [{k.fx}, {k.fy}, {k.cx}, {k.cy}]\n  resolution: [{k.width}, {k.height}]\n"
        text += f"  rostopic: /cam{i}/image_raw\n"
        if i:
            T = se_inverse(T_WORLD[i]) @ T_WORLD[i - 1]
            text += "  T_cn_cnm1:\n" + "".join(f"  - {row.tolist()}\n" for row in T)
    path.write_text(text)


def test_kalibrs_camchain(tmp_path, capsys):
    camchain(tmp_path / "camchain.yaml")
    assert convert(tmp_path, tmp_path / "camchain.yaml") == 0
    assert capsys.readouterr().out == f"{tmp_path / 'rig.yaml'}: cam0, cam1, cam2\n"
    is_the_rig(tmp_path, ("cam0", "cam1", "cam2"))


def write_colmap(folder, units_per_metre):
    folder.mkdir()
    cameras, images = "# Camera list\n", "# Image list\n"
    for i, k in enumerate(CAMERAS, 1):
        lens = " ".join(map(str, k.distortion or (0, 0, 0, 0)))
        cameras += f"{i} OPENCV {k.width} {k.height} {k.fx} {k.fy} {k.cx + 0.5} {k.cy + 0.5} {lens}\n"
        T = se_inverse(T_WORLD[i - 1])
        x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
        t = " ".join(map(repr, map(float, units_per_metre * T[:3, 3])))
        images += f"{i} {w} {x} {y} {z} {t} {i} views/camera_{i}.png\n{'1.5 2.5 -1' if i != 2 else ''}\n"
    (folder / "cameras.txt").write_text(cameras)
    (folder / "images.txt").write_text(images)


@pytest.mark.parametrize(("unit", "units_per_metre"), [("m", 1.0), ("cm", 100.0)])
def test_colmaps_text_model(tmp_path, unit, units_per_metre):
    write_colmap(tmp_path / "sparse", units_per_metre)
    assert convert(tmp_path, tmp_path / "sparse", "--length-unit", unit) == 0
    is_the_rig(tmp_path, ("camera_1", "camera_2", "camera_3"))


def write_open3d(path, cameras=CAMERAS):
    parameters = []
    for k, T in zip(cameras, T_WORLD, strict=False):
        intrinsic = {"width": k.width, "height": k.height, "intrinsic_matrix": k.matrix().T.ravel().tolist()}
        extrinsic = se_inverse(T).T.ravel().tolist()
        parameters.append({"class_name": "PinholeCameraParameters", "extrinsic": extrinsic, "intrinsic": intrinsic})
    path.write_text(json.dumps({"class_name": "PinholeCameraTrajectory", "parameters": parameters}))


def test_open3ds_camera_trajectory(tmp_path):
    plain = [PinholeIntrinsics(k.width, k.height, k.fx, k.fy, k.cx, k.cy) for k in CAMERAS]
    write_open3d(tmp_path / "cameras.json", plain)
    assert convert(tmp_path, tmp_path / "cameras.json") == 0
    is_the_rig(tmp_path, ("camera0", "camera1", "camera2"), plain)


def write_matlab(path, **changes):
    T = se_inverse(POSES[1])
    values = {"R": T[:3, :3], "om": Rotation.from_matrix(T[:3, :3]).as_rotvec(), "T": 1000.0 * T[:3, 3:]}
    for side, k in (("left", LEFT), ("right", RIGHT)):
        values |= {f"fc_{side}": np.array([[k.fx], [k.fy]]), f"cc_{side}": np.array([[k.cx], [k.cy]])}
        values |= {f"kc_{side}": np.array([*k.distortion, 0.0]), f"alpha_c_{side}": 0.0}
    values = {name: value for name, value in (values | changes).items() if value is not None}
    scipy.io.savemat(path, values)


@pytest.mark.parametrize("changes", [{}, {"R": None}])
def test_a_matlab_stereo_calibration(tmp_path, changes, capsys):
    write_matlab(tmp_path / "Calib_Results_stereo.mat", **changes)
    path = tmp_path / "Calib_Results_stereo.mat"
    assert convert(tmp_path, path, "--length-unit", "mm") == 1
    assert "the image size is not in it; give it with --size" in capsys.readouterr().err
    assert convert(tmp_path, path, "--length-unit", "mm", "--size", "640x480") == 0
    is_the_rig(tmp_path, ("left", "right"))


def write_stereo_parameters(path, *, new=False, **changes):
    """As toStruct of MATLAB's stereoParameters has it: points are rows, pixels are counted from 1."""
    values = {"Version": {"Release": "(R2023a)"}, "RectificationParams": {"Initialized": False}}
    for i, k in enumerate((LEFT, RIGHT), 1):
        K = k.matrix()
        K[:2, 2] += 1.0
        radial, tangential = [k.distortion[0], k.distortion[1], 0.0], k.distortion[2:4]
        camera = {"RadialDistortion": np.array(radial), "TangentialDistortion": np.array(tangential)}
        camera |= {"ImageSize": np.array([480.0, 640.0]), "WorldUnits": "millimeters", "WorldPoints": np.zeros((0, 2))}
        values[f"CameraParameters{i}"] = camera | ({"K": K} if new else {"IntrinsicMatrix": K.T})
    T = se_inverse(POSES[1])
    values |= {"RotationOfCamera2": T[:3, :3].T, "TranslationOfCamera2": 1000.0 * T[:3, 3]}
    scipy.io.savemat(path, {"stereoParams": values | changes})


@pytest.mark.parametrize("new", [False, True])
def test_matlabs_stereo_parameters(tmp_path, new):
    write_stereo_parameters(tmp_path / "rig.mat", new=new)
    assert convert(tmp_path, tmp_path / "rig.mat", "--length-unit", "mm") == 0
    is_the_rig(tmp_path, ("camera1", "camera2"))


def write_multical(path, *, master=None, **changes):
    cameras, poses = {}, {}
    for i, k in enumerate(CAMERAS):
        lens = [[*(k.distortion or (0.0,) * 4), 0.0]]
        size = [k.width, k.height]
        cameras[f"cam{i}"] = {"model": "standard", "image_size": size, "K": k.matrix().tolist(), "dist": lens}
        T = se_inverse(T_WORLD[i]) @ (np.eye(4) if master is None else T_WORLD[master])
        key = f"cam{i}" if master in (None, i) else f"cam{i}_to_cam{master}"
        poses[key] = {"R": T[:3, :3].tolist(), "T": T[:3, 3].tolist()}
    cameras["cam0"] |= changes
    path.write_text(json.dumps({"cameras": cameras, "camera_poses": poses, "image_sets": {"rgb": []}}))


@pytest.mark.parametrize("master", [None, 0, 1])
def test_multicals_calibration(tmp_path, master):
    write_multical(tmp_path / "calibration.json", master=master)
    assert convert(tmp_path, tmp_path / "calibration.json") == 0
    is_the_rig(tmp_path, ("cam0", "cam1", "cam2"))


def bag_of_cameras(path, kind, transforms=(), **more):
    small = [np.zeros((240, 320, 3), np.uint8)], [np.ones((240, 320), np.uint16)]
    streams = []
    for i in range(2):
        streams.append((f"/cam_{i}/color/image_raw", f"cam_{i}", THIRD, "rgb8", small[0]))
        streams.append((f"/cam_{i}/aligned_depth_to_color/image_raw", f"cam_{i}", THIRD, "16UC1", small[1]))
    return write_ros_bag(path, kind, streams, transforms, **more)


def test_the_cameras_of_a_ros_bag(tmp_path):
    bag = bag_of_cameras(tmp_path / "rig", "mcap", [("base", f"cam_{i}", T_WORLD[i]) for i in range(2)])
    assert convert(tmp_path, bag) == 0
    is_the_rig(tmp_path, ("cam_0", "cam_1"), (THIRD, THIRD))


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_transforms_that_are_published_again_and_again_and_stand_still(tmp_path, kind):
    moments = [[("odom", "base", pose((0, 0, i), (i, 0, 0))), ("base", "cam_1", T_WORLD[1])] for i in range(3)]
    bag = bag_of_cameras(tmp_path / "rig", kind, [("base", "cam_0", T_WORLD[0])], repeated=moments)
    assert convert(tmp_path, bag) == 0
    is_the_rig(tmp_path, ("cam_0", "cam_1"), (THIRD, THIRD))


def test_a_camera_that_moves_against_the_other_has_no_pose(tmp_path, capsys):
    moments = [[("base", "cam_1", pose((0, 0, angle), (0.3, 0, 0)))] for angle in (0.0, 0.01)]
    bag = bag_of_cameras(tmp_path / "rig", "mcap", [("base", "cam_0", T_WORLD[0])], repeated=moments)
    assert convert(tmp_path, bag) == 0
    assert "the pose of cam_1 is unknown" in capsys.readouterr().out


def test_what_cannot_be_used_is_one_line(tmp_path, capsys):
    camchain(tmp_path / "fish.yaml", "equidistant")
    camchain(tmp_path / "chain.yaml")
    text = (tmp_path / "chain.yaml").read_text()
    (tmp_path / "alone.yaml").write_text(text[: text.index("  T_cn_cnm1")] + "cam2:" + text.split("cam2:")[1])
    write_colmap(tmp_path / "moving", 1.0)
    images = (tmp_path / "moving/images.txt").read_text()
    (tmp_path / "moving/images.txt").write_text(images.replace(" 2 views/camera_2", " 1 views/camera_2"))
    write_colmap(tmp_path / "fisheye", 1.0)
    cameras = (tmp_path / "fisheye/cameras.txt").read_text()
    (tmp_path / "fisheye/cameras.txt").write_text(cameras.replace("OPENCV", "OPENCV_FISHEYE"))
    write_open3d(tmp_path / "open3d.json")
    broken = (tmp_path / "open3d.json").read_text().replace('"extrinsic": [', '"extrinsic": [7.0, ', 1)
    (tmp_path / "open3d.json").write_text(broken)
    write_matlab(tmp_path / "skew.mat", alpha_c_left=0.1)
    write_matlab(tmp_path / "short.mat", kc_left=np.zeros(3))
    write_stereo_parameters(tmp_path / "turned.mat", RotationOfCamera2=2.0 * np.eye(3))
    write_stereo_parameters(tmp_path / "one.mat", CameraParameters2=np.eye(3))
    write_multical(tmp_path / "multical.json", model="fisheye")
    text = (tmp_path / "multical.json").read_text().replace("fisheye", "standard")
    (tmp_path / "two.json").write_text(text.replace('"cam1": {"R"', '"cam7": {"R"'))
    (tmp_path / "notes.txt").write_text("no rig")
    for name, message in (
        ("fish.yaml", "expected radtan or none, got equidistant"),
        ("alone.yaml", "key 'T_cn_cnm1' is missing"),
        ("moving", "images.txt:4: camera 1 or name 'camera_2' is there twice"),
        ("fisheye", "cameras.txt:2: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS"),
        ("open3d.json", "parameters[0]: extrinsic: expected 16 finite numbers"),
        ("skew.mat", "alpha_c_left: expected no skew"),
        ("short.mat", "kc_left: expected (5,) finite numbers"),
        ("turned.mat", "RotationOfCamera2"),
        ("one.mat", "expected the structures CameraParameters1 and CameraParameters2"),
        ("multical.json", "cameras: cam0: model: expected standard, rational"),
        ("two.json", "camera_poses: there is no pose of cam1"),
        ("notes.txt", "expected Kalibr's camchain, Open3D's camera trajectory"),
    ):
        assert convert(tmp_path, tmp_path / name, "--size", "640x480") == 1, name
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and message in err and name in err, err
    assert not (tmp_path / "rig.yaml").exists()


@pytest.mark.parametrize("name", ["camchain.yaml", "cameras.json", "stereo.mat", "rig.mat", "multi.json", "sparse"])
def test_damage_is_an_error_of_ours(tmp_path, name):
    path = tmp_path / name
    writers = {"camchain.yaml": camchain, "cameras.json": write_open3d, "stereo.mat": write_matlab}
    writers |= {"rig.mat": write_stereo_parameters, "multi.json": write_multical}
    writers.get(name, lambda folder: write_colmap(folder, 1.0))(path)
    files = [path] if path.is_file() else sorted(path.iterdir())
    whole, rng = {file: file.read_bytes() for file in files}, np.random.default_rng(2)
    absurd = [b"nan", b"1e999", b"-", b"[", b"{", b"\x00", b"\xff", b"9" * 400, b"null", b"&a", b"\n", b""]
    for number in range(150):
        for file, data in whole.items():
            at, cut = rng.integers(len(data), size=2)
            damaged = data[:at] + absurd[rng.integers(len(absurd))] + data[at + rng.integers(12) :]
            file.write_bytes(damaged[:cut] if number % 5 == 0 else damaged)
        try:
            read_rig_file(path, size=(640, 480))
        except AdaGMMError as problem:
            assert str(path) in str(problem) and "\n" not in str(problem)
