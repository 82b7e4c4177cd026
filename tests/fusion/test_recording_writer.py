"""Whatever a recording's format, its copy in our own layout holds the same frames, poses, times and pairs."""

import numpy as np
import pytest
from depth_scene import camera_pose, write_apc, write_images, write_pose_file, write_redwood, write_tum, write_xtion

from adagmm_fusion.cli import main
from adagmm_fusion.errors import OutputError, RecordingError
from adagmm_fusion.formats.tum import INTRINSICS as TUM_INTRINSICS
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.recordings.writer import convert_recording, with_plain_names
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, load_rig, save_rig

SMALL = PinholeIntrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)
POSES = [camera_pose(yaw, (0.05 * i, 0.1 * i, 1.2)) for i, yaw in enumerate((-12.0, 2.0, 14.0))]


def write_own_moving(folder, poses, intrinsics):
    """Two sensors on one moving rig, which is lost in the last frame."""
    T_rig_sensor = {"left": camera_pose(3.0), "right": camera_pose(30.0, (0.0, 0.3, 0.0))}
    text = "format: adagmm-recording\nversion: 1\nname: cart\nrig: rig.yaml\nmotion: moving\n"
    text += "sensors: [left, right]\nframes:\n"
    for i, pose in enumerate(poses):
        text += f'  - name: "{i}"\n'
        if i < 2:
            text += f"    T_world_rig: {pose.tolist()}\n    timestamps: {{left: {i}.5}}\n"
        for name, T in T_rig_sensor.items():
            write_images(
                *(folder / name / kind / f"{i}.png" for kind in ("color", "depth")), intrinsics, pose @ T, 1000
            )
    sensors = {name: SensorCalibration(name, intrinsics, 1000.0, T) for name, T in T_rig_sensor.items()}
    save_rig(folder / "rig.yaml", Rig("cart", sensors))
    (folder / "recording.yaml").write_text(text)


def write_two_xtion(folder, poses, intrinsics):
    T = np.eye(4)
    T[0, 3] = -0.025
    write_xtion(folder, poses[:2], intrinsics, intrinsics, T)


WRITERS = {
    "tum": lambda folder: write_tum(folder, POSES, TUM_INTRINSICS["1"]),
    "redwood": lambda folder: write_redwood(folder, POSES, SMALL),
    "posefile": lambda folder: write_pose_file(folder, POSES, SMALL),
    "apc": lambda folder: write_apc(folder, POSES, SMALL),
    "xtion": lambda folder: write_two_xtion(folder, POSES, SMALL),
    "adagmm": lambda folder: write_own_moving(folder, POSES, SMALL),
}


@pytest.mark.parametrize("format", WRITERS)
def test_the_copy_holds_the_same(tmp_path, format):
    WRITERS[format](tmp_path / "original")
    original = open_recording(tmp_path / "original")
    assert original.format == format
    progress = []
    manifest = convert_recording(original, tmp_path / "copy", on_frame=lambda *numbers: progress.append(numbers))
    assert manifest == tmp_path / "copy" / "recording.yaml"
    count = len(original.frames())
    assert progress == [(i, count) for i in range(1, count + 1)]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["copy", "original"]
    copy = open_recording(tmp_path / "copy")
    assert (copy.format, copy.name, copy.sensors, len(copy)) == (
        "adagmm",
        original.name,
        original.sensors,
        len(original),
    )
    for a, b in zip(original, copy, strict=True):
        assert a.name == b.name
        for x, y in ((a.source, b.source), (a.target, b.target)):
            assert (x.sensor, x.timestamp, x.intrinsics, x.depth_scale) == (
                y.sensor,
                y.timestamp,
                y.intrinsics,
                y.depth_scale,
            )
            assert np.array_equal(x.color, y.color) and y.depth.dtype == np.uint16
            if x.depth.dtype == np.uint16:
                assert np.array_equal(x.depth, y.depth)
            else:
                np.testing.assert_allclose(y.depth_m(), x.depth_m(), rtol=1e-6, atol=0.51e-3)
        np.testing.assert_allclose(b.T_target_source, a.T_target_source, rtol=0, atol=1e-12)


def memory_recording(
    tmp_path, depths, poses=(None, None), sensors=("a", "a"), names=("0", "1"), scales=(1000.0, 1000.0)
):
    entries = []
    for name, sensor, depth, pose, scale in zip(names, sensors, depths, poses, scales, strict=True):
        frame = RGBDFrame(name, np.zeros((48, 64, 3), np.uint8), depth, SMALL, scale, sensor)
        entries.append(FrameEntry(name, sensor, lambda frame=frame: frame, pose))
    return Recording("memory", tmp_path / "memory", "test", tuple(entries), (PairEntry(1, 0),))


def test_depth_in_metres_becomes_millimetres(tmp_path):
    depth = np.full((48, 64), 1.2344, np.float32)
    depth[0, :3] = (np.nan, np.inf, -1.0)
    convert_recording(memory_recording(tmp_path, [depth, depth], scales=(1.0, 1.0)), tmp_path / "copy")
    frame = open_recording(tmp_path / "copy")[0].source
    assert frame.depth_scale == 1000.0 and (frame.depth[1:] == 1234).all() and not frame.depth[0, :3].any()


def test_depth_that_16_bits_do_not_hold_is_refused(tmp_path):
    """It was written as no depth, without a word."""
    depth = np.full((48, 64), 65.535, np.float32)
    convert_recording(memory_recording(tmp_path, [depth, depth], scales=(1.0, 1.0)), tmp_path / "copy")
    assert (open_recording(tmp_path / "copy")[0].source.depth == 65535).all()
    far = depth.copy()
    far[0, 0] = 70.0
    match = r"memory: a: frame 1: expected depth up to 65\.535 m, .* got 70 m; set what is farther to 0"
    with pytest.raises(RecordingError, match=match):
        convert_recording(memory_recording(tmp_path, [depth, far], scales=(1.0, 1.0)), tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_unknown_poses_stay_unknown(tmp_path):
    depth = np.full((48, 64), 1000, np.uint16)
    two = memory_recording(tmp_path, [depth, depth], sensors=("a", "b"), names=("0", "0"))
    convert_recording(two, tmp_path / "copy")
    assert open_recording(tmp_path / "copy")[0].T_target_source is None
    assert load_rig(tmp_path / "copy" / "rig.yaml").sensors["b"].T_rig_sensor is None


@pytest.mark.parametrize(
    "changes, match",
    [
        ({"sensors": ("a", "b")}, "frame 0 was not seen by b"),
        ({"names": ("0", "0")}, "a has two frames 0"),
        ({"names": ("0", "../1")}, "no plain file name"),
        ({"scales": (1000.0, 2000.0)}, "a changes its intrinsics or depth scale in 1"),
    ],
)
def test_what_does_not_fit_the_layout(tmp_path, changes, match):
    depth = np.full((48, 64), 1000, np.uint16)
    with pytest.raises(RecordingError, match=match):
        convert_recording(memory_recording(tmp_path, [depth, depth], **changes), tmp_path / "copy")
    assert not any(tmp_path.iterdir())


def test_names_that_the_layout_does_not_take_are_changed_and_that_is_said(tmp_path):
    frames = tmp_path / "frames"
    for i, name in enumerate(("Bild 0", "Büro 1", "_2")):
        write_images(frames / f"rgb/{name}.png", frames / f"depth/{name}.png", SMALL, POSES[i], 1000)
    np.savetxt(frames / "K.txt", SMALL.matrix())
    assert main(["convert", str(frames), str(tmp_path / "ours")]) == 0
    recording = open_recording(tmp_path / "ours")
    assert sorted(entry.name for entry in recording.entries) == ["B_ro_1", "Bild_0", "_2"]
    assert with_plain_names(open_recording(frames)).notes[-1].startswith("2 frames have other names, such as ")
    assert with_plain_names(recording) is recording


def test_sensors_that_move_against_each_other(tmp_path):
    write_own_moving(tmp_path / "original", POSES, SMALL)
    original = open_recording(tmp_path / "original")
    entries = list(original.entries)
    moved = entries[3].T_world_camera.copy()
    moved[0, 3] += 0.01
    entries[3] = FrameEntry(entries[3].name, entries[3].sensor, entries[3].load, moved)
    changed = Recording(original.name, original.path, original.format, tuple(entries), original.pairs)
    with pytest.raises(RecordingError, match="right has moved against left in frame 1"):
        convert_recording(changed, tmp_path / "copy")


def test_nothing_is_overwritten_and_nothing_is_left_half_done(tmp_path):
    write_redwood(tmp_path / "original", POSES, SMALL)
    original = open_recording(tmp_path / "original")
    with pytest.raises(OutputError, match="is there already"):
        convert_recording(original, tmp_path / "original")
    next((tmp_path / "original/depth").glob("00002-*")).write_bytes(b"")
    with pytest.raises(RecordingError, match="empty or something else"):
        convert_recording(original, tmp_path / "copy")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        convert_recording(original, tmp_path / "file" / "copy")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "original"]
