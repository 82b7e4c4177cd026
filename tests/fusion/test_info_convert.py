"""`adagmm-fusion info` and `convert`: what they say about recordings made here, and what they refuse."""

import numpy as np
import pytest
from depth_scene import camera_pose, write_images, write_pose_file, write_tum, write_xtion
from folder_layouts import write_folder

from adagmm_fusion.cli import main
from adagmm_fusion.formats.tum import INTRINSICS as TUM_INTRINSICS
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.recordings.summary import summarize_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, save_rig

SMALL = PinholeIntrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)
DISTORTED = PinholeIntrinsics(80, 48, 62.0, 63.0, 39.5, 23.5, (0.1, -0.05, 0.0, 0.0))
POSES = [camera_pose(yaw, (0.05 * i, 0.1 * i, 1.2)) for i, yaw in enumerate((-12.0, 2.0, 14.0))]
MISSING = 64 / (64 * 48)  # depth_scene leaves a corner of 8 x 8 pixels without depth


@pytest.fixture
def rig_recording(tmp_path):
    """Two sensors of different sizes, three moments, the second sensor 4, 5 and 6 ms late."""
    folder = tmp_path / "pair"
    text = "format: adagmm-recording\nversion: 1\nname: desk\nrig: rig.yaml\nmotion: fixed\nsensors: [left, right]\n"
    text += "frames:\n"
    sensors = {"left": (SMALL, camera_pose(0.0)), "right": (DISTORTED, camera_pose(30.0, (0.3, 0.4, 1.2)))}
    for i in range(3):
        text += f'  - name: "{i}"\n    timestamps: {{left: {i}.0, right: {i}.00{4 + i}}}\n'
        for name, (intrinsics, T) in sensors.items():
            write_images(folder / name / "color" / f"{i}.png", folder / name / "depth" / f"{i}.png", intrinsics, T, 1e3)
    (folder / "recording.yaml").write_text(text)
    save_rig(folder / "rig.yaml", Rig("desk", {n: SensorCalibration(n, k, 1e3, T) for n, (k, T) in sensors.items()}))
    return folder


def test_a_rig_is_summarized(rig_recording):
    counted = []
    recording = open_recording(rig_recording)
    summary = summarize_recording(recording, on_frame=lambda *numbers: counted.append(numbers))
    assert counted == [(i, 6) for i in range(1, 7)]
    assert summary.problems == []
    np.testing.assert_allclose(summary.time_offsets_s, (0.004, 0.005, 0.006), rtol=0, atol=1e-12)
    np.testing.assert_allclose(summary.true_rotations_deg, [30.0] * 3, rtol=0, atol=1e-9)
    np.testing.assert_allclose(summary.true_translations_m, [0.5] * 3, rtol=0, atol=1e-12)
    left, right = summary.sensors.values()
    assert (left.frames, left.poses, left.intrinsics, left.depth_scales) == (3, 3, [SMALL], [1000.0])
    assert (right.intrinsics, right.depth_dtypes) == ([DISTORTED], ["uint16"])
    assert left.missing_depth == pytest.approx(MISSING, rel=1e-12)
    depth = recording[0].target.depth / 1000.0
    np.testing.assert_allclose(left.median_depths_m, [np.median(depth[depth > 0])] * 3, rtol=1e-6, atol=0)


def test_info_prints_it(rig_recording, capsys):
    assert main(["info", str(rig_recording)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    rows = {cells[0].strip(): [c.strip() for c in cells[1:]] for cells in _cells(out)}
    assert rows["sensors"] == ["left, right"]
    assert (rows["frames"], rows["pairs"]) == (["3", "3"], ["3"])  # the sensors' table comes later
    assert rows["time between the frames of a pair"] == ["5 ms, from 4 to 6"]
    assert rows["ground truth"] == ["known; apart by 30 °; 0.5 m"]
    assert rows["image size"] == ["64 x 48", "80 x 48"]
    assert rows["focal length fx, fy"] == ["60, 61 px", "62, 63 px"]
    assert rows["distortion"] == ["none", "0.1, -0.05, 0, 0"]
    assert rows["depth scale"] == ["1000 per metre"] * 2
    assert rows["missing depth"] == [f"{100 * MISSING:.1f} %", f"{100 * 64 / (80 * 48):.1f} %"]


def test_frames_that_cannot_be_read_are_named_and_the_rest_is_told(rig_recording, capsys):
    depth = rig_recording / "right" / "depth" / "1.png"
    depth.write_bytes(depth.read_bytes()[:100])
    assert main(["info", str(rig_recording)]) == 1
    out, err = capsys.readouterr()
    assert err == f"adagmm-fusion: {depth}: the image is cut off or damaged; get the file again\n"
    assert "3, 1 unreadable" in out


def test_a_recording_without_ground_truth_says_so(tmp_path, capsys):
    T = np.eye(4)
    T[0, 3] = -0.025
    write_xtion(tmp_path / "rig", POSES[:2], SMALL, SMALL, T)
    (tmp_path / "rig" / "images" / "T_cam1_to_cam2_reference.txt").unlink()
    assert main(["info", str(tmp_path / "rig")]) == 0
    rows = {cells[0].strip(): [c.strip() for c in cells[1:]] for cells in _cells(capsys.readouterr().out)}
    assert rows["ground truth"] == ["not known"]
    assert rows["time between the frames of a pair"] == ["not known"]
    assert rows["depth"] == ["float32"] * 2


def test_convert_writes_our_layout_once(tmp_path, capsys):
    write_tum(tmp_path / "tum", POSES, TUM_INTRINSICS["1"])
    out = tmp_path / "new" / "copy"
    assert main(["convert", str(tmp_path / "tum"), str(out), "--step", "2"]) == 0
    assert capsys.readouterr().out == f"{out / 'recording.yaml'}: 3 frame(s) of kinect, 1 pair(s)\n"
    original, copy = open_recording(tmp_path / "tum", step=2), open_recording(out)
    assert copy.format == "adagmm" and len(copy) == 1
    np.testing.assert_array_equal(copy[0].source.depth, original[0].source.depth)
    np.testing.assert_array_equal(copy[0].source.color, original[0].source.color)
    np.testing.assert_allclose(copy[0].T_target_source, original[0].T_target_source, rtol=0, atol=1e-9)

    assert main(["convert", str(tmp_path / "tum"), str(out)]) == 1
    assert (
        capsys.readouterr().err == f"adagmm-fusion: {out}: is there already and not an empty folder; give a new one\n"
    )
    assert len(open_recording(out)) == 1


def test_convert_says_what_info_says(tmp_path, capsys):
    write_folder(tmp_path / "walk", POSES, SMALL)
    (tmp_path / "walk" / "depth" / "0001.png").unlink()
    assert main(["info", str(tmp_path / "walk")]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")]
    assert any("left out, without their depth image" in line for line in said)
    assert any("taken for millimetres" in line for line in said)
    assert main(["convert", str(tmp_path / "walk"), str(tmp_path / "copy")]) == 0
    assert [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")] == said


def test_convert_takes_format_and_calibration(tmp_path):
    write_pose_file(tmp_path / "walk", POSES, SMALL)
    save_rig(tmp_path / "rig.yaml", Rig("other", {"camera": SensorCalibration("camera", SMALL, 2000.0, None)}))
    arguments = ["--format", "posefile", "--calibration", str(tmp_path / "rig.yaml")]
    assert main(["convert", str(tmp_path / "walk"), str(tmp_path / "copy"), *arguments]) == 0
    assert open_recording(tmp_path / "copy").frames().frame(0).depth_scale == 2000.0


def test_a_conversion_that_fails_leaves_nothing(tmp_path, capsys):
    write_pose_file(tmp_path / "walk", POSES, SMALL)
    (tmp_path / "walk" / "depth" / "00014.png").write_bytes(b"nothing")
    assert main(["convert", str(tmp_path / "walk"), str(tmp_path / "copy")]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "00014.png" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["walk"]


@pytest.mark.parametrize("command", [["info", "nowhere"], ["convert", "nowhere", "out"]])
def test_a_recording_that_is_not_there_is_one_line(command, capsys):
    assert main(command) == 1
    assert capsys.readouterr().err == "adagmm-fusion: nowhere: there is no such recording\n"


def _cells(text: str) -> list[list[str]]:
    return [line.strip("│┃").replace("┃", "│").split("│") for line in text.splitlines() if line[0] in "│┃"]
