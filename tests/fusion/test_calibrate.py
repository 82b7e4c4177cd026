"""`adagmm-fusion calibrate` on rendered boards of a known rig: how near it comes, and what it says of bad images."""

import re
import shutil
from copy import deepcopy

import cv2
import numpy as np
import pytest
from board_scene import board_pose, charuco_pattern, chessboard_pattern, render_board, turns, write_view
from scipy.spatial.transform import Rotation

from adagmm_fusion.board_calibration.boards import Charuco, Chessboard, parse_board_size
from adagmm_fusion.board_calibration.rig_calibration import calibrate_rig
from adagmm_fusion.board_calibration.views import find_boards
from adagmm_fusion.cli import main
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.rigs.rig import load_rig
from adagmm_o3d.errors import InputError
from adagmm_o3d.evaluation import pose_errors
from adagmm_o3d.lie import se_inverse

pytestmark = pytest.mark.slow

LEFT = PinholeIntrinsics(640, 480, 525.0, 527.0, 322.0, 238.0, (0.08, -0.15, 0.001, -0.0007, 0.02))
RIGHT = PinholeIntrinsics(640, 480, 540.0, 538.0, 315.0, 245.0, (-0.05, 0.06, 0.0, 0.001, 0.0))
T_LEFT_RIGHT = np.eye(4)
T_LEFT_RIGHT[:3, :3] = Rotation.from_euler("xyz", (3.0, -22.0, 2.0), degrees=True).as_matrix()
T_LEFT_RIGHT[:3, 3] = (0.35, 0.02, 0.06)
VIEWS, SQUARE_M = 12, 0.045
CHESSBOARD = ["--chessboard", "9x6", "--square", str(SQUARE_M)]
CHARUCO = ["--charuco", "9x6", "--square", "0.05", "--marker", "0.0375", "--dictionary", "4X4_50"]


def render_rig(folder, pattern, square_m, poses, *, depth=True):
    rng = np.random.default_rng(11)
    for i, T in enumerate(poses):
        for name, k, T_sensor_left in (("left", LEFT, np.eye(4)), ("right", RIGHT, se_inverse(T_LEFT_RIGHT))):
            image, z = render_board(pattern, square_m, k, T_sensor_left @ T)
            noisy = np.clip(np.rint(image + rng.normal(0.0, 2.0, image.shape)), 0, 255).astype(np.uint8)
            write_view(folder / name, f"{i:03d}", noisy, z if depth else None)


@pytest.fixture(scope="module")
def chessboards(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chessboards") / "desk"
    render_rig(folder, chessboard_pattern(9, 6), SQUARE_M, turns(VIEWS, np.random.default_rng(5)))
    return folder


@pytest.fixture(scope="module")
def charucos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("charucos") / "desk"
    render_rig(folder, charuco_pattern(9, 6, 45, "4X4_50"), 0.05, turns(VIEWS, np.random.default_rng(5)), depth=False)
    return folder


@pytest.fixture(scope="module")
def found(chessboards):
    return find_boards(chessboards, Chessboard(9, 6, SQUARE_M))


@pytest.fixture
def views(found):
    return deepcopy(found)


@pytest.fixture
def copy(chessboards, tmp_path):
    return shutil.copytree(chessboards, tmp_path / "desk")


def change(paths, function):
    for path in paths:
        assert cv2.imwrite(str(path), function(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)))


def hidden(image):
    """With a bar across, as an arm before the board."""
    image = image.copy()
    image[:, 200:300] = 90
    return image


def failure(folder, capsys, *arguments) -> str:
    """The one line that `calibrate` ends with; nothing is written then."""
    output = folder.parent / "no-rig.yaml"
    assert main(["calibrate", str(folder), "--output", str(output), *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and not output.exists()
    return err.removeprefix("adagmm-fusion: ").rstrip("\n")


def is_the_rig(rig, rotation_deg=0.1):
    errors = pose_errors(T_LEFT_RIGHT, rig.T_target_source("left", "right"))
    assert errors.rotation_deg < rotation_deg and errors.translation < 0.002


def test_a_chessboard_gives_the_rig(chessboards, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", str(chessboards), *CHESSBOARD]) == 0
    out, err = capsys.readouterr()
    assert err == "" and out.endswith("rig: calibration/desk.yaml\n")
    rig = load_rig(tmp_path / "calibration" / "desk.yaml")
    is_the_rig(rig)
    assert rig.name == "desk"
    np.testing.assert_array_equal(rig.sensors["left"].T_rig_sensor, np.eye(4))
    for name, true in (("left", LEFT), ("right", RIGHT)):
        k = rig.sensors[name].intrinsics
        np.testing.assert_allclose((k.fx, k.fy, k.cx, k.cy), (true.fx, true.fy, true.cx, true.cy), rtol=0, atol=1.0)
        assert (k.width, k.height, len(k.distortion)) == (640, 480, 5)
    assert "000" in out and "outlier" not in out


def test_a_charuco_board_gives_the_rig(charucos, tmp_path):
    assert main(["calibrate", str(charucos), *CHARUCO, "--output", str(tmp_path / "rig.yaml")]) == 0
    is_the_rig(load_rig(tmp_path / "rig.yaml"))


def test_partly_hidden_charuco_boards_are_used_as_far_as_they_are_seen(charucos, tmp_path):
    folder = shutil.copytree(charucos, tmp_path / "desk")
    change(sorted(folder.glob("*/color/*.png"))[::3], hidden)
    assert main(["calibrate", str(folder), *CHARUCO, "--output", str(tmp_path / "rig.yaml")]) == 0
    is_the_rig(load_rig(tmp_path / "rig.yaml"), rotation_deg=0.2)


def test_depth_is_held_against_the_board(chessboards, views):
    result = calibrate_rig(views, Chessboard(9, 6, SQUARE_M), name="desk", folder=chessboards)
    for sensor in result.sensors.values():
        assert sensor.depth_units_per_metre == pytest.approx(1000.0, rel=0.002)
        assert sensor.depth_spread < 1.0
    assert result.warnings == ()


def test_another_depth_unit_is_refused_and_named(chessboards, capsys):
    message = failure(chessboards, capsys, *CHESSBOARD, "--depth-scale", "5000")
    assert message.startswith(f"{chessboards}: left: the depth images have ")
    assert "units per metre of the board, not 5000" in message


def test_a_square_measured_wrong_shows_in_the_depth(chessboards, tmp_path, capsys):
    arguments = ["--chessboard", "9x6", "--square", str(0.95 * SQUARE_M), "--output", str(tmp_path / "rig.yaml")]
    assert main(["calibrate", str(chessboards), *arguments]) == 0
    err = capsys.readouterr().err
    assert err.count("\n") == 2 and "left: depth is 5.3 % longer than the board says" in err


def test_a_board_that_moved_between_the_sensors_is_an_outlier_and_named(copy, tmp_path, capsys):
    shutil.copy(copy / "right" / "color" / "003.png", copy / "right" / "color" / "008.png")
    shutil.rmtree(copy / "right" / "depth")
    assert main(["calibrate", str(copy), *CHESSBOARD, "--output", str(tmp_path / "rig.yaml")]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "outlier" in line]
    assert len(lines) == 1 and lines[0].startswith("│ 008")
    is_the_rig(load_rig(tmp_path / "rig.yaml"))


def test_a_blurred_view_is_an_outlier_and_named(chessboards, views):
    pixels = views["left"].corners["005"].pixels
    pixels += np.random.default_rng(3).normal(0.0, 3.0, pixels.shape)
    result = calibrate_rig(views, Chessboard(9, 6, SQUARE_M), name="desk", folder=chessboards)
    assert list(result.sensors["left"].outliers_px) == ["005"] and not result.sensors["right"].outliers_px
    assert "005" not in result.links[0].errors_px
    is_the_rig(result.rig)


def test_mirrored_chessboards_are_noticed(copy, capsys):
    shutil.rmtree(copy / "right" / "depth")
    change((copy / "right" / "color").glob("*.png"), lambda image: image[:, ::-1])
    assert "right and left: the images of one of them are mirrored" in failure(copy, capsys, *CHESSBOARD)


def test_a_mirrored_charuco_board_is_noticed(charucos, tmp_path, capsys):
    folder = shutil.copytree(charucos, tmp_path / "desk")
    change([folder / "left" / "color" / "002.png"], lambda image: image[:, ::-1])
    message = failure(folder, capsys, *CHARUCO)
    assert message.startswith(f"{folder / 'left' / 'color' / '002.png'}: the board is mirrored")


def test_partly_hidden_chessboards_are_too_few(copy, capsys):
    change(sorted((copy / "left" / "color").glob("*.png"))[: VIEWS - 4], hidden)
    message = failure(copy, capsys, *CHESSBOARD)
    found = re.search(
        rf"left: expected at least 5 good views of the board, got (\d), found in (\d) of {VIEWS} images", message
    )
    assert found and int(found[1]) <= int(found[2]) < VIEWS
    assert "(not in 0" in message and "a ChArUco board need not" in message


def test_a_hidden_chessboard_is_not_found_half():
    image, _ = render_board(chessboard_pattern(9, 6), SQUARE_M, LEFT, board_pose((0, 0, 0), (-0.15, -0.1, 0.8)))
    board = Chessboard(9, 6, SQUARE_M)
    assert board.find(image) is not None
    assert board.find(hidden(image)) is None


def test_one_subsampled_image_is_named(copy, capsys):
    path = copy / "right" / "color" / "004.png"
    change([path], lambda image: image[::2, ::2])
    message = failure(copy, capsys, *CHESSBOARD)
    assert message.startswith(f"{path}: expected 640x480 pixels as the sensor's other images, got 320x240")


def test_subsampled_beyond_recognition(copy, capsys):
    shutil.rmtree(copy / "left" / "depth")
    change((copy / "left" / "color").glob("*.png"), lambda image: image[::12, ::12])
    message = failure(copy, capsys, *CHESSBOARD)
    assert "left: expected at least 5 good views of the board, got 0" in message and "large enough" in message


def test_boards_that_all_face_the_sensor_leave_the_focal_length_open(tmp_path, capsys):
    poses = [board_pose((0, 0, 0), (-0.2, -0.15, z)) for z in (0.8, 0.85, 0.9, 0.95, 1.0)]
    render_rig(tmp_path / "desk", chessboard_pattern(9, 6), SQUARE_M, poses, depth=False)
    shutil.rmtree(tmp_path / "desk" / "right")
    message = failure(tmp_path / "desk", capsys, *CHESSBOARD)
    assert "left: the 5 views leave the focal length open" in message and "tilted" in message


def test_sensors_without_common_views(copy, capsys):
    shutil.rmtree(copy / "right" / "depth")
    for path in (copy / "right" / "color").glob("*.png"):
        path.rename(path.with_name(f"b{path.name}"))
    message = failure(copy, capsys, *CHESSBOARD)
    assert "right and left: expected at least 3 views in which both see the board well, got 0" in message


def test_views_out_of_step(copy, capsys):
    shutil.rmtree(copy / "right" / "depth")
    names = sorted(path.name for path in (copy / "right" / "color").glob("*.png"))
    for i, name in enumerate(names):
        (copy / "right" / "color" / name).rename(copy / "right" / f"{(i + 1) % VIEWS:03d}.png")
    for path in (copy / "right").glob("*.png"):
        path.rename(copy / "right" / "color" / path.name)
    message = failure(copy, capsys, *CHESSBOARD)
    assert "right and left: " in message and ("no rigid rig explains" in message or "contradict" in message)


def test_folders_that_hold_no_boards(tmp_path, capsys):
    assert "there is no such folder" in failure(tmp_path / "nowhere", capsys, *CHESSBOARD)
    (tmp_path / "empty").mkdir()
    assert "expected <sensor>/color/ folders" in failure(tmp_path / "empty", capsys, *CHESSBOARD)
    (tmp_path / "empty" / "left" / "color").mkdir(parents=True)
    assert "expected images of the board, got none" in failure(tmp_path / "empty", capsys, *CHESSBOARD)


def test_depth_of_another_size_is_refused(copy):
    path = copy / "left" / "depth" / "000.png"
    change([path], lambda image: image[::2, ::2])
    with pytest.raises(RecordingError, match=r"000\.png: expected 640x480 pixels as the colour image, got 320x240"):
        find_boards(copy, Chessboard(9, 6, SQUARE_M))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--chessboard", "9x7", "--square", "0.03"], "an even and an odd number"),
        (["--chessboard", "9by6", "--square", "0.03"], "--chessboard: expected columns x rows"),
        (["--chessboard", "2x9", "--square", "0.03"], "at least 3x3 inner corners"),
        (["--chessboard", "9x6", "--square", "-1"], "square: expected a positive length"),
        (["--charuco", "9x6", "--square", "0.03"], "--marker: give"),
        (["--charuco", "9x6", "--square", "0.03", "--marker", "0.03"], "marker: expected less than"),
        (["--charuco", "9x6", "--square", "0.03", "--marker", "0.02", "--dictionary", "Latin"], "dictionary: expected"),
        (["--charuco", "30x30", "--square", "0.03", "--marker", "0.02"], "4X4_50 has 50 markers"),
        (["--chessboard", "9x6", "--square", "0.03", "--depth-scale", "0"], "--depth-scale: expected positive"),
    ],
)
def test_boards_that_do_not_exist(tmp_path, capsys, arguments, message):
    assert message in failure(tmp_path / "nowhere", capsys, *arguments)


@pytest.mark.parametrize("quarter_turns", range(4))
def test_the_chessboards_origin_does_not_depend_on_how_it_is_held(quarter_turns):
    T = board_pose((0, 0, 90.0 * quarter_turns), (0.0, 0.0, 1.0))
    T[:3, 3] -= T[:3, :3] @ (0.18, 0.1125, 0.0)  # turned about its middle
    image, _ = render_board(chessboard_pattern(9, 6), SQUARE_M, LEFT, T)
    board = Chessboard(9, 6, SQUARE_M)
    expected, _ = cv2.projectPoints(
        board.points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], LEFT.matrix(), np.array(LEFT.distortion)
    )
    np.testing.assert_allclose(board.find(image).pixels, expected.reshape(-1, 2), rtol=0, atol=0.25)


def test_charuco_corners_are_where_they_are_printed():
    T = board_pose((15.0, -10.0, 30.0), (-0.1, -0.15, 0.9))
    image, _ = render_board(charuco_pattern(9, 6, 45, "4X4_50"), 0.05, LEFT, T)
    board = Charuco(9, 6, 0.05, 0.0375, "4X4_50")
    found = board.find(image)
    assert len(found.ids) == 40
    points = board.points[found.ids] - (0.05, 0.05, 0.0)  # the pattern's origin is its first inner corner
    expected, _ = cv2.projectPoints(
        points, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], LEFT.matrix(), np.array(LEFT.distortion)
    )
    np.testing.assert_allclose(found.pixels, expected.reshape(-1, 2), rtol=0, atol=0.25)


def test_sizes_are_parsed():
    assert parse_board_size("11x8", "--chessboard") == (11, 8)
    with pytest.raises(InputError, match=r"^--charuco: expected columns x rows as 9x6, got '9x'"):
        parse_board_size("9x", "--charuco")
