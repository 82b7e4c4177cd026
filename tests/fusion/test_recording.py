"""Our own layout, opening and choosing formats, and what happens when files are missing, damaged or lead elsewhere."""

import pickle

import cv2
import numpy as np
import pytest
from depth_scene import camera_pose, write_images, write_pose_file

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import FORMATS, open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig
from adagmm_o3d.errors import InputError
from adagmm_o3d.lie import se_inverse

INTRINSICS = PinholeIntrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
POSES = {
    "left": camera_pose(-12.0),
    "right": camera_pose(14.0, (0.1, 0.5, 1.3)),
    "top": camera_pose(0.0, (0, 0, 2.0), 50.0),
}
HEAD = "format: adagmm-recording\nversion: 1\nname: two in a room\nrig: rig.yaml\n"


def make_rig(*names, unknown=()):
    sensors = {
        name: SensorCalibration(name, INTRINSICS, 1000.0, None if name in unknown else POSES[name]) for name in names
    }
    return Rig("room", sensors)


@pytest.fixture
def fixed(tmp_path):
    """Two still sensors, two frames."""
    folder = tmp_path / "recordings" / "room"
    for sensor in ("left", "right"):
        for frame in ("000000", "000001"):
            paths = (folder / sensor / kind / f"{frame}.png" for kind in ("color", "depth"))
            write_images(*paths, INTRINSICS, POSES[sensor], 1000)
    save_rig(folder / "rig.yaml", make_rig("left", "right"))
    (folder / "recording.yaml").write_text(HEAD + "motion: fixed\nsensors: [left, right]\n")
    return folder


def test_fixed_sensors_pair_with_the_first_one(fixed):
    recording = open_recording(fixed)
    assert (recording.name, recording.format, recording.sensors) == ("two in a room", "adagmm", ("left", "right"))
    assert len(recording) == 2 and len(recording.frames()) == 4
    pairs = list(recording)
    assert [p.name for p in pairs] == ["000000_right_to_left", "000001_right_to_left"]
    assert [p.index for p in pairs] == [0, 1] and recording[-1].index == 1
    with pytest.raises(IndexError):
        recording[2]
    pair = pairs[0]
    assert (pair.source.sensor, pair.target.sensor) == ("right", "left")
    np.testing.assert_allclose(pair.T_target_source, se_inverse(POSES["left"]) @ POSES["right"], rtol=0, atol=1e-15)


def test_frames_without_a_depth_image_of_the_first_sensor_are_said(fixed):
    (fixed / "left" / "depth" / "000001.png").unlink()
    recording = open_recording(fixed)
    assert [entry.name for entry in recording.entries] == ["000000"] * 2
    assert recording.notes == ("left out, without their depth image of left: 000001",)


def test_frames_with_timestamps_and_pairs_across_time(fixed):
    (fixed / "recording.yaml").write_text(
        HEAD + "motion: fixed\nsensors: [left, right]\nframes:\n"
        '  - {name: "000001", timestamps: {left: 1.5, right: 1.25}}\n'
        '  - {name: "000000"}\n'
        "pairs: [{source: right/000000, target: left/000001}]\n"
    )
    recording = open_recording(fixed)
    frames = recording.frames()
    assert [frames.timestamp(i) for i in range(4)] == [1.5, 1.25, None, None]
    assert [(frames.name(i), frames.sensor(i)) for i in (0, 1)] == [("000001", "left"), ("000001", "right")]
    pair = recording[0]
    assert pair.name == "right_000000_to_left_000001" and pair.target.timestamp == 1.5
    np.testing.assert_allclose(pair.T_target_source, se_inverse(POSES["left"]) @ POSES["right"], rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ("{source: left/000000, target: left/000000}", "pair 000000_to_000000: expected two frames, got one as both"),
        (", ".join(["{source: right/000000, target: left/000000}"] * 2), "two pairs are 000000_right_to_left; list"),
    ],
)
def test_a_pair_is_of_two_frames_and_listed_once(fixed, pairs, message):
    """An image fits itself, which says nothing; results of one name would replace each other."""
    with open(fixed / "recording.yaml", "a") as file:
        file.write(f"pairs: [{pairs}]\n")
    with pytest.raises(RecordingError, match=message):
        open_recording(fixed)


def test_three_sensors_make_two_pairs_a_frame(fixed):
    paths = (fixed / "top" / kind / "000000.png" for kind in ("color", "depth"))
    write_images(*paths, INTRINSICS, POSES["top"], 1000)
    save_rig(fixed / "rig.yaml", make_rig("left", "right", "top"))
    text = HEAD + 'motion: fixed\nsensors: [left, right, top]\nframes: [{name: "000000"}]\n'
    (fixed / "recording.yaml").write_text(text)
    assert [p.name for p in open_recording(fixed)] == ["000000_right_to_left", "000000_top_to_left"]


def test_unknown_extrinsics_are_no_truth(fixed):
    recording = open_recording(fixed, rig=make_rig("left", "right", unknown=("right",)))
    assert recording[0].T_target_source is None


def moving(fixed, frames, tail=""):
    """One sensor on the move, whose camera is turned in its rig."""
    sensors = {"left": SensorCalibration("left", INTRINSICS, 1000.0, POSES["top"])}
    save_rig(fixed / "rig.yaml", Rig("one", sensors))
    (fixed / "recording.yaml").write_text(HEAD + "motion: moving\nsensors: [left]\nframes:\n" + frames + tail)
    return open_recording(fixed)


def test_moving_rig_composes_its_pose_with_the_sensors(fixed):
    def row(T):
        return str(T.tolist())

    T = [camera_pose(5.0), camera_pose(25.0, (1, 2, 3))]
    frames = "".join(f'  - {{name: "00000{i}", T_world_rig: {row(T[i])}}}\n' for i in (0, 1))
    recording = moving(fixed, frames)
    assert [p.name for p in recording] == ["000001_to_000000"]
    expected = se_inverse(T[0] @ POSES["top"]) @ T[1] @ POSES["top"]
    np.testing.assert_allclose(recording[0].T_target_source, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(recording.frames().pose(1), T[1] @ POSES["top"], rtol=0, atol=1e-14)


def test_moving_rig_without_poses_knows_only_its_own_sensors(fixed):
    assert moving(fixed, '  - {name: "000000"}\n  - {name: "000001"}\n')[0].T_target_source is None
    save_rig(fixed / "rig.yaml", make_rig("left", "right"))
    (fixed / "recording.yaml").write_text(HEAD + "motion: moving\nsensors: [left, right]\n")
    expected = se_inverse(POSES["left"]) @ POSES["right"]
    np.testing.assert_allclose(open_recording(fixed)[0].T_target_source, expected, rtol=0, atol=1e-15)


def test_rig_is_sought_in_the_recording_and_then_beside_recordings(fixed):
    calibration = fixed.parent.parent / "calibration"
    calibration.mkdir()
    (fixed / "rig.yaml").rename(calibration / "rig.yaml")
    assert len(open_recording(fixed)) == 2
    (calibration / "rig.yaml").unlink()
    with pytest.raises(RecordingError, match=r"recording\.yaml:4: rig: rig\.yaml is neither in the recording nor at"):
        open_recording(fixed)
    save_rig(calibration / "other.yaml", make_rig("left", "right"))
    assert len(open_recording(fixed, rig=calibration / "other.yaml")) == 2
    with pytest.raises(RigError, match="no sensor 'right'; this rig has left"):
        open_recording(fixed, rig=make_rig("left"))


@pytest.mark.parametrize(
    "text, match",
    [
        (
            HEAD.replace("version: 1", "version: 3") + "motion: fixed\nsensors: [left]\n",
            "2: version: expected 1, got 3",
        ),
        (HEAD + "motion: fixed\n", "1: the document: key 'sensors' is missing"),
        (HEAD + "motion: still\nsensors: [left]\n", "5: motion: expected fixed or moving"),
        (HEAD + "motion: fixed\nsensors: []\n", "6: sensors: expected at least one"),
        (HEAD + "motion: fixed\nsensors: [left, left]\n", r"6: sensors\[1\]: sensor 'left' is listed twice"),
        (HEAD + "motion: fixed\nsensors: [../left]\n", r"6: sensors\[0\]: expected a name"),
        (HEAD.replace("rig.yaml", "../rig.yaml") + "motion: fixed\nsensors: [left]\n", "4: rig: expected a file name"),
        (HEAD + "motion: fixed\nsensors: [left]\nframes: [{name: ../0}]\n", r"7: frames\[0\]\.name: expected a file"),
        (HEAD + "motion: fixed\nsensors: [left]\nframes: [{name: a}, {name: a}]\n", "listed twice"),
        (HEAD + "motion: fixed\nsensors: [left]\nframes: [{name: a, T_world_rig: []}]\n", "motion is fixed"),
        (HEAD + "motion: moving\nsensors: [left]\nframes: [{name: a, T_world_rig: []}]\n", "expected 4 rows"),
        (HEAD + "motion: fixed\nsensors: [left]\nframes: [{name: a, timestamps: {right: 0}}]\n", "unknown key 'right'"),
        (
            HEAD + "motion: fixed\nsensors: [left]\npairs: [{source: left/000009, target: left/000000}]\n",
            "7: .*sensor/frame",
        ),
        (HEAD + "motion: fixed\nsensors: [left]\npairs: []\n", "no pair of frames"),
        (HEAD + "motion: fixed\nsensors: [nobody]\n", "no sensor 'nobody'"),
        (HEAD + "motion: fixed\nsensors: [left]\nwidth: 640\n", "7: width: unknown key 'width'"),
    ],
)
def test_a_wrong_manifest_is_refused_with_its_line(fixed, text, match):
    (fixed / "recording.yaml").write_text(text)
    with pytest.raises(InputError, match=match) as caught:
        open_recording(fixed)
    assert str(caught.value).startswith(str(fixed)) and "\n" not in str(caught.value)


def test_a_pose_that_is_not_rigid_is_refused_with_its_line(fixed):
    (fixed / "recording.yaml").write_text(
        HEAD + "motion: moving\nsensors: [left]\nframes:\n  - name: '000000'\n    T_world_rig: "
        "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]\n"
    )
    with pytest.raises(RecordingError, match=r"recording\.yaml:9: frames\[0\]\.T_world_rig: pose: .*not a rotation"):
        open_recording(fixed)


def test_images_are_read_only_when_asked_for(fixed):
    recording = open_recording(fixed)
    (fixed / "right" / "color" / "000001.png").unlink()
    assert recording[0].source.name == "000000"
    with pytest.raises(RecordingError, match=r"right/color/000001\.png: the image is missing"):
        recording[1]


def test_a_recording_can_be_sent_to_another_process(fixed):
    copy = pickle.loads(pickle.dumps(open_recording(fixed)))
    assert np.array_equal(copy[1].source.depth, open_recording(fixed)[1].source.depth)


def write_png(path, image):
    assert cv2.imwrite(str(path), image)


def cut(path, keep):
    path.write_bytes(path.read_bytes()[:keep])


def flip_a_byte(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x55
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    "kind, damage, match",
    [
        ("depth", lambda p: cut(p, -12), "cut off or damaged"),
        ("depth", lambda p: cut(p, 300), "cut off or damaged"),
        ("depth", lambda p: cut(p, 0), "empty or something else"),
        ("depth", flip_a_byte, "cut off or damaged"),
        ("depth", lambda p: p.write_text("no image"), "empty or something else"),
        ("depth", lambda p: p.unlink(), "is missing"),
        ("depth", lambda p: (p.unlink(), p.mkdir()), "cannot be read"),
        ("depth", lambda p: write_png(p, np.zeros((48, 64), np.uint8)), "one 16-bit channel, got 1 of 8 bits"),
        ("depth", lambda p: write_png(p, np.zeros((48, 64, 3), np.uint16)), "got 3 of 16 bits"),
        ("depth", lambda p: write_png(p, np.zeros((24, 32), np.uint16)), "color is 64x48 and depth 32x24"),
        ("color", lambda p: cut(p, 300), "cut off or damaged"),
        ("color", lambda p: write_png(p, np.zeros((24, 32, 3), np.uint8)), "color is 32x24 and depth 64x48"),
    ],
)
def test_damaged_images_are_one_clear_error(fixed, capfd, kind, damage, match):
    damage(fixed / "right" / kind / "000000.png")
    with pytest.raises(RecordingError, match=match) as caught:
        open_recording(fixed)[0]
    assert str(caught.value).startswith(str(fixed / "right")) and "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_both_images_of_another_size_than_the_intrinsics(fixed):
    paths = (fixed / "right" / kind / "000000.png" for kind in ("color", "depth"))
    write_images(*paths, PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0), POSES["right"], 1000)
    with pytest.raises(
        RecordingError, match=r"depth/000000\.png: .* images are 32x24 and the intrinsics are for 64x48"
    ):
        open_recording(fixed)[0]


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg"])
def test_jpeg_colour_and_its_damage(fixed, capfd, suffix):
    png = fixed / "right/color/000000.png"
    jpeg = png.with_suffix(suffix)
    image = cv2.imread(str(png))
    assert cv2.imwrite(str(jpeg), image)
    with pytest.raises(RecordingError, match=rf"000000\.png: there is 000000\{suffix} beside it"):
        open_recording(fixed)[0]
    png.unlink()
    decoded = open_recording(fixed)[0].source.color
    assert np.abs(decoded.astype(int) - image[:, :, ::-1]).mean() < 10
    cut(jpeg, -40)
    with pytest.raises(RecordingError, match="cut off or damaged"):
        open_recording(fixed)[0]
    assert capfd.readouterr().err == ""


def test_a_rotated_jpeg_stays_on_the_depths_grid(fixed):
    png = fixed / "right/color/000000.png"
    jpeg = png.with_suffix(".jpg")
    data = cv2.imencode(".jpg", cv2.imread(str(png)))[1].tobytes()
    plain = open_recording(fixed)[0].source.color
    png.unlink()
    # EXIF says "rotate by 90 degrees": TIFF header, one entry, tag 0x0112 (orientation), type short, value 6.
    tiff = b"MM\x00*\x00\x00\x00\x08\x00\x01\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00\x00\x00\x00\x00"
    exif = b"Exif\x00\x00" + tiff
    jpeg.write_bytes(data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:])
    assert cv2.imread(str(jpeg)).shape[:2] == (64, 48)
    assert np.abs(open_recording(fixed)[0].source.color.astype(int) - plain).mean() < 10


def test_links_that_lead_out_are_refused(fixed, tmp_path):
    depth = fixed / "right/depth/000000.png"
    outside = depth.rename(tmp_path / "outside.png")
    depth.symlink_to(outside)
    with pytest.raises(RecordingError, match=r"right/depth/000000\.png' leads out of the recording folder"):
        open_recording(fixed)[0]
    depth.unlink()
    outside.rename(fixed / "inside.png")
    depth.symlink_to(fixed / "inside.png")
    assert open_recording(fixed)[0].source.depth.shape == (48, 64)


def test_missing_sensor_folder(fixed):
    (fixed / "left" / "depth").rename(fixed / "depth_of_left")
    with pytest.raises(RecordingError, match="left/depth: the folder of depth images is missing"):
        open_recording(fixed)


def test_what_is_no_recording(tmp_path):
    with pytest.raises(RecordingError, match="there is no such recording"):
        open_recording(tmp_path / "absent")
    with pytest.raises(RecordingError, match="not a recording of a known format; it holds "):
        open_recording(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="file: not a recording of a known format"):
        open_recording(tmp_path / "file")


def test_two_formats_in_one_folder_must_be_told_apart(tmp_path):
    poses = [POSES["left"], POSES["right"]]
    write_pose_file(tmp_path, poses, INTRINSICS)
    for name in ("rgb.txt", "depth.txt"):
        (tmp_path / name).write_text("")
    with pytest.raises(RecordingError, match="could be tum or posefile; say which"):
        open_recording(tmp_path)
    assert open_recording(tmp_path, format="posefile").format == "posefile"


@pytest.mark.parametrize(
    "options, match", [({"format": "zip"}, "format: expected one of adagmm"), ({"step": 0}, "step")]
)
def test_bad_options(fixed, options, match):
    with pytest.raises(InputError, match=match):
        open_recording(fixed, **options)


def test_every_format_says_what_it_is():
    for name, module in FORMATS.items():
        assert name == module.NAME and module.SUMMARY and module.__doc__
