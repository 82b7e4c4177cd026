"""The calibration files of a folder: which camera's they are, of which lens, image size and depth unit."""

import json

import numpy as np
import pytest
from folder_layouts import write_color, write_depth

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats.camera_files import read_camera_file
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration

SMALL = PinholeIntrinsics(160, 120, 140.0, 141.0, 79.0, 60.5)
ROWS = "\n".join(" ".join(map(str, row)) for row in SMALL.matrix())
TWICE = "280 0 158.5\n0 282 121.5\n0 0 1\n"
NAMED = {"fx": 140.0, "fy": 141.0, "cx": 79.0, "cy": 60.5}
OTHER = {"fx": 100.0, "fy": 100.0, "cx": 80.0, "cy": 60.0}
UNIT = "depth is taken for millimetres, no file says so"


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    write_color(folder / "color/0.png", SMALL, np.eye(4))
    write_depth(folder / "depth/0.png", SMALL, np.eye(4), 1000)
    return folder


@pytest.fixture
def recorded(tmp_path, images):
    """What opening a folder of images with these files gives."""

    def opened(files, **options):
        for kind in ("color", "depth"):
            (tmp_path / kind).mkdir(exist_ok=True)
            for name in ("0.png", "1.png"):
                (tmp_path / kind / name).write_bytes((images / kind / "0.png").read_bytes())
        for name, content in files.items():
            (tmp_path / name).write_text(content if isinstance(content, str) else json.dumps(content))
        return open_recording(tmp_path, **options)

    return opened


def intrinsics(recording):
    return recording.entries[0].load().intrinsics


def refused(recorded, files, match):
    with pytest.raises(RecordingError, match=match) as caught:
        recorded(files)
    assert "\n" not in str(caught.value)


# Two cameras in one file

BOTH = {
    "depth before color": {"depth": OTHER | {"k1": 0.5}, "color": NAMED},
    "orbbec": {
        "depthIntrinsic": OTHER, "rgbIntrinsic": NAMED, "depthDistortion": {"k1": 0.5}, "rgbDistortion": {"k1": 0.0},
    },
    "nested": {"cameras": {"ir": {"intrinsics": OTHER}, "colour": {"intrinsics": NAMED}}},
    "by kind of field": {"intrinsics": {"depth": OTHER, "rgb": NAMED}, "distortion": {"depth": {"k1": 1}, "rgb": {}}},
    "prefixes": {f"{name}_{k}": v for name, its in (("depth", OTHER), ("color", NAMED)) for k, v in its.items()},
    "matrices": {"depth_K": [[100, 0, 80], [0, 100, 60], [0, 0, 1]], "color_K": SMALL.matrix().tolist()},
}  # fmt: skip


@pytest.mark.parametrize("name", BOTH)
def test_of_two_cameras_in_a_file_the_colour_cameras_count(recorded, name):
    recording = recorded({"camera.json": BOTH[name]})
    assert intrinsics(recording) == SMALL
    assert "camera.json: the depth camera's intrinsics are not used" in recording.notes[0]


def test_the_depth_camera_of_such_a_file_is_used_where_it_is_said_where_it_is(recorded):
    poses = {"depth_to_color.txt": "1 0 0 0.05\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"}
    alone = recorded({"camera.json": {"color": NAMED}}).entries[0].load()
    both = recorded({"camera.json": {"color": NAMED, "depth": NAMED}, **poses})
    assert both.notes == (UNIT,) and intrinsics(both) == SMALL
    assert not np.array_equal(both.entries[0].load().depth, alone.depth)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        ({"left": NAMED, "right": OTHER}, "the intrinsics of 2 cameras \\('left' and 'right'\\), and which is"),
        ({"color": {"a": NAMED, "b": OTHER}}, "the intrinsics of 2 cameras \\('color.a' and 'color.b'\\)"),
        ({**NAMED, "color": OTHER}, "not clear; call them color and depth"),
        ({**NAMED, "depth": OTHER}, "not clear; call them color and depth"),
        ({"color": NAMED, "depth": OTHER, "k1": 0.1}, "k1: of which camera is this lens distortion"),
        ({**NAMED, "a": {"width": 160, "height": 120}, "b": {"width": 320, "height": 240}}, "width: given twice"),
    ],
)
def test_what_is_not_clear_of_two_cameras_is_refused(recorded, content, match):
    refused(recorded, {"camera.json": content}, match)


def test_sections_of_a_text_file_are_cameras_too(recorded):
    rows = {name: "\n".join(f"{k} = {v}" for k, v in its.items()) for name, its in (("a", NAMED), ("b", OTHER))}
    assert intrinsics(recorded({"calib.txt": f"[depth]\n{rows['b']}\n[color]\n{rows['a']}\n"})) == SMALL
    refused(recorded, {"calib.txt": f"[LEFT_CAM]\n{rows['a']}\n[RIGHT_CAM]\n{rows['b']}\n"}, "of 2 cameras")
    refused(recorded, {"calib.txt": f"{rows['a']}\n{rows['b']}\n"}, "fx is there twice, 140.0 and 100.0")


# Another lens


@pytest.mark.parametrize(
    "stated",
    [
        {"distortion_model": "equidistant", "D": [0.1, 0, 0, 0]},
        {"camera_model": "fisheye", "k1": 0.1},
        {"is_fisheye": True},
        {"fisheye": {"k1": 0.1}},
        {"model": "Inverse Brown Conrady", "distortion": [0.1, 0, 0, 0, 0]},
    ],
)
def test_another_lens_model_is_refused(recorded, stated):
    refused(recorded, {"k.json": NAMED | stated}, "expected plumb_bob or rational_polynomial, got .*undistort")


def test_coefficients_in_lists_and_in_data_are_kept(recorded):
    for given in ([[0.1, 0, 0.01, 0]], {"rows": 1, "cols": 4, "data": [0.1, 0, 0.01, 0]}, "0.1 0 0.01 0"):
        recording = recorded({"k.json": NAMED | {"distortion_coefficients": given, "model": "inverse"}})
        assert intrinsics(recording).distortion == (0.1, 0.0, 0.01, 0.0)
    refused(recorded, {"k.json": NAMED | {"distortion": 0.1}}, "distortion: this lens distortion is not understood")


# Image size


@pytest.mark.parametrize(
    "size",
    [
        {"image_size": [320, 240]},
        {"resolution": [320, 240]},
        {"resolution": "320x240"},
        {"resolution": {"width": 320, "height": 240}},
        {"img_width": 320, "img_height": 240},
        {"imageWidth": "320", "imageHeight": "240"},
        {"shape": [240, 320, 3]},
    ],
)
def test_intrinsics_of_another_image_size_are_scaled(recorded, size):
    K = [[280.0, 0, 158.5], [0, 282.0, 121.5], [0, 0, 1]]
    assert intrinsics(recorded({"k.json": {"K": K} | size})) == SMALL


def test_half_an_image_size_is_refused(recorded):
    refused(recorded, {"k.json": NAMED | {"width": 160}}, "expected the image's width and height, got only one")


def test_a_principal_point_far_from_the_middle_is_said(recorded):
    recording = recorded({"K.txt": TWICE})
    assert recording.notes[0] == (
        "K.txt: fx 280 fy 282 cx 158.5 cy 121.5 look like those of another image size than 160x120; say which, as "
        "width and height in intrinsics.json"
    )
    assert recorded({"K.txt": ROWS}).notes == (UNIT,)


@pytest.mark.parametrize("size", [{}, {"width": 160, "height": 120}])
def test_cx_and_cy_that_look_exchanged_are_said(recorded, size):
    recording = recorded({"k.json": NAMED | {"cx": 60.5, "cy": 79.0} | size})
    said = "k.json: cx 60.5 cy 79 look exchanged, for images of 160x120; if they are, exchange them in the file"
    assert recording.notes == (said, UNIT)
    # Off in one direction, or in both and exchanged as well: a part of a larger image.
    for cx, cy in ((60.5, 60.0), (80.0, 79.0), (60.5, 100.0)):
        notes = recorded({"k.json": NAMED | {"cx": cx, "cy": cy} | size}).notes
        assert not any("exchanged" in note for note in notes)


def test_of_two_files_that_for_the_images_size_is_taken(recorded, tmp_path):
    recording = recorded({"K_a.txt": "300 0 200\n0 300 150\n0 0 1\n", "K_b.txt": ROWS})
    assert intrinsics(recording) == SMALL
    assert recording.notes[0] == "intrinsics are those of K_b.txt, which fit 160x120 images; not K_a.txt"
    (tmp_path / "K_a.txt").rename(tmp_path / "K_a_320x240.txt")
    recording = recorded({"K_a_320x240.txt": TWICE, "K_b.txt": ROWS})  # the same, scaled
    assert intrinsics(recording) == SMALL and recording.notes == (UNIT,)
    (tmp_path / "K_a_320x240.txt").unlink()
    refused(recorded, {"K_a.txt": "150 0 79\n0 150 60\n0 0 1\n"}, "K_a.txt and K_b.txt: two different calibrations")


# Depth unit

ROS = f"image_width: 160\nimage_height: 120\nK: {SMALL.matrix().ravel().tolist()}\nD: [0.0]\n"
ORB = "Camera.type: PinHole\nCamera.fx: 140.0\nCamera.fy: 141.0\nCamera.cx: 79.0\nCamera.cy: 60.5\nCamera.k1: 0.0\n"


@pytest.mark.parametrize(
    ("name", "content", "scale"),
    [
        ("camera.yaml", ROS + "depth_scale: 5000.0\n", 5000.0),
        ("camera.yaml", ROS + "depth_units: 0.00025\n", 4000.0),
        ("camera.yaml", ORB + "DepthMapFactor: 5000.0\n", 5000.0),
        ("camera.yaml", f"%YAML:1.0\n---\n{ORB}RGBD.DepthMapFactor: 5000.0\n", 5000.0),
        ("camera.yaml", "%YAML:1.0\n---\n" + ORB.replace("Camera.", "Camera1.") + "DepthMapFactor: 5000.\n", 5000.0),
        ("camera.json", NAMED | {"depth_units": 0.00025}, 4000.0),
        ("camera.json", NAMED | {"depth_units": "mm"}, 1000.0),
        ("camera.json", {"color": NAMED, "depth": {"scale": 0.0002}}, 5000.0),
    ],
)
def test_the_depth_unit_that_a_file_says_counts(recorded, name, content, scale):
    recording = recorded({name: content})
    assert intrinsics(recording) == SMALL
    assert recording.entries[0].load().depth_scale == pytest.approx(scale, rel=1e-12) and recording.notes == ()


def test_a_depth_unit_that_cannot_be_is_refused(recorded):
    refused(recorded, {"k.json": NAMED | {"depth_units": 1000}}, "depthunits: expected metres a unit, as 0.001")
    refused(recorded, {"k.json": NAMED | {"depth_units": 0.001, "depth_scale": 5000}}, "do not agree on the depth unit")
    files = {"k.json": NAMED | {"depth_scale": 1000}, "depth_intrinsics.json": NAMED | {"depth_scale": 5000}}
    refused(recorded, files, "expected one depth scale, got 5000 and 1000|got 1000 and 5000")


# What is understood, and what is not

UNDERSTOOD = {
    "headings": ("K.csv", "fx,fy,cx,cy\n140,141,79,60.5\n"),
    "headings with a size": ("K.csv", "width height fx fy cx cy\n320 240 280 282 158.5 121.5\n"),
    "six numbers": ("K.txt", "320 240 280 282 158.5 121.5\n"),
    "3x4": ("K.txt", "140 0 79 0\n0 141 60.5 0\n0 0 1 0\n"),
    "hardly any skew": ("K.txt", "140 1e-9 79\n0 141 60.5\n0 0 1\n"),
    "text": ("k.json", {name: str(value) for name, value in NAMED.items()}),
    "a matrix as text": ("k.json", {"K": "140 0 79 0 141 60.5 0 0 1"}),
    "names and values": ("K.csv", "fx,140\nfy,141\ncx,79\ncy,60.5\n"),
    "orb-slam": ("camera.yaml", "%YAML:1.0\n---\n" + ORB),
    "orb-slam, of any name": ("TUM1.yaml", "%YAML:1.0\r\n---\r\n" + ORB.replace("\n", "\r\n")),
}


@pytest.mark.parametrize("name", UNDERSTOOD)
def test_more_ways_to_write_intrinsics(recorded, name):
    file, content = UNDERSTOOD[name]
    assert intrinsics(recorded({file: content})) == SMALL


def test_other_yaml_files_are_nobodys_calibration(recorded, tmp_path):
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe")
    recording = recorded({"intrinsics.json": NAMED, "run.yaml": "speed: 5\nnote: see Camera.fx\n"})
    assert intrinsics(recording) == SMALL and not any(".yaml" in note for note in recording.notes)


def test_a_file_that_is_not_understood_is_named(recorded, tmp_path):
    refused(recorded, {"K.csv": "140;0;79\n0;141\n"}, "no intrinsics; K.csv: not understood, expected a 3x3 or 4x4")
    recording = recorded({"intrinsics.json": NAMED})
    assert recording.notes[0] == "not understood as a calibration and not used: K.csv"
    refused(recorded, {"K.csv": "140 0 79 5\n0 141 60 0\n0 0 1 0\n"}, "fourth column zero, got \\[5.0, 0.0, 0.0\\]")
    rig = Rig("one", {"a": SensorCalibration("a", SMALL, 1000.0, None)})
    assert intrinsics(recorded({}, rig=rig)) == SMALL


def test_where_the_depth_camera_is_must_be_a_matrix_in_metres(recorded, tmp_path):
    files = {
        "color_intrinsics.txt": ROWS,
        "depth_intrinsics.txt": ROWS,
        "depth_to_color.json": {"translation": [25, 0, 0]},
    }
    refused(recorded, files, "expected where the depth camera is as a 4x4 matrix in metres in a .txt file, got .json")
    millimetres = "1 0 0 -25\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
    refused(recorded, {"depth_to_color.txt": millimetres}, "expected metres .* got 25, which looks like millimetres")
    (tmp_path / "depth_to_color.txt").write_text(millimetres.replace("-25", "-0.025"))
    (tmp_path / "depth_intrinsics.txt").unlink()
    assert "depth_to_color.txt is not used: depth is taken as registered" in recorded({}).notes[0]


def test_a_fisheye_in_orb_slams_file_is_refused(tmp_path):
    (tmp_path / "camera.yaml").write_text("%YAML:1.0\n---\n" + ORB.replace("PinHole", "KannalaBrandt8"))
    with pytest.raises(RecordingError, match=r"camera\.type: expected plumb_bob or rational_polynomial, got"):
        read_camera_file(tmp_path / "camera.yaml")


@pytest.mark.parametrize(
    ("values", "match"),
    [
        ({"cx": 10**400}, "expected finite|principal point|cx"),
        ({"depth_scale": 10**400}, "depthscale: expected a positive number"),
        ({"width": 10**400, "height": 1}, "expected an image size in pixels"),
    ],
)
def test_whole_numbers_beyond_all_bounds_are_refused(recorded, values, match):
    refused(recorded, {"k.json": NAMED | values}, match)


def test_many_cameras_in_a_file_are_refused_in_no_time(recorded):
    many = {str(i): NAMED | {"fx": 140.0 + i} for i in range(5000)}
    refused(recorded, {"k.json": many}, "the intrinsics of 5000 cameras")
    assert intrinsics(recorded({"k.json": dict.fromkeys(map(str, range(5000)), NAMED)})) == SMALL
