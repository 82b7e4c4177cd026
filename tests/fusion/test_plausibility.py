"""Sensors that are mirrored, shifted, in a wrong unit or deliver disparity are named, and sound ones are left alone."""

import re
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from depth_scene import camera_pose, write_redwood
from shared_data import ROOT, shared_data

from adagmm_fusion.cli import main
from adagmm_fusion.frames.depth_checks import (
    UNIT_MISTAKES,
    color_offset,
    looks_like_disparity,
    nearer_than_cameras_see,
    unit_mistake,
)
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.pairs.mirrored import agreeing_matches, looks_mirrored
from adagmm_fusion.pairs.plausibility import recording_warnings, sensor_warnings
from adagmm_fusion.recordings.frame_sequence import FrameEntry, PairEntry, Recording
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration
from adagmm_o3d.lie import se_inverse

SHIPPED = ROOT / "recordings" / "two_kinects"


@pytest.fixture(scope="module")
def shipped():
    return open_recording(SHIPPED)


@pytest.fixture(scope="module")
def frames(shipped):
    """Two frames of the right sensor: rendered, with a Kinect's steps and noise."""
    return [entry.load() for entry in shipped.entries if entry.sensor == "right"][:2]


def changed(recording: Recording, sensor: str | None, change) -> Recording:
    """The recording as it would be if a sensor (or all) delivered other frames."""
    entries = tuple(
        FrameEntry(e.name, e.sensor, lambda e=e: change(e.load()), e.T_world_camera, e.timestamp)
        if sensor in (None, e.sensor)
        else e
        for e in recording.entries
    )
    return replace(recording, entries=entries)


def mirrored(frame):
    flip = {name: np.ascontiguousarray(getattr(frame, name)[:, ::-1]) for name in ("color", "depth")}
    return replace(frame, **flip)


def shifted(frame, right, down=0):
    """What comes in over the border has no depth."""
    depth = np.roll(frame.depth, (down, right), (0, 1))
    rows, columns = np.indices(depth.shape)
    height, width = depth.shape
    there = (rows >= down) & (rows < height + down) & (columns >= right) & (columns < width + right)
    return replace(frame, depth=np.where(there, depth, 0).astype(np.uint16))


def disparity(frame):
    """4e6 / depth, as a stereo camera's disparity image is."""
    d = np.where(frame.depth > 0, 4e6 / np.maximum(frame.depth, 1), 0)
    return replace(frame, depth=d.clip(0, 65535).astype(np.uint16))


@pytest.mark.slow
def test_sound_recordings_are_left_alone(shipped):
    assert recording_warnings(shipped) == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["apc_shelf_f200", "hololens_tof", "redwood_open3d_5frames", "tum_fr1_rpy_kinect_v1", "two_xtion_rig"],
)
def test_real_recordings_are_left_alone(name):
    """Five kinds of sensors."""
    assert recording_warnings(open_recording(shared_data("recordings", name))) == ()


@pytest.mark.parametrize(("right", "down"), [(25, 0), (-25, 0), (12, -9)])
def test_depth_beside_its_colour(frames, right, down):
    offset = color_offset([shifted(frame, right, down) for frame in frames])
    assert not offset.mirrored
    # The sensor's shadows are on one side of what casts them, which makes 2 px.
    np.testing.assert_allclose((offset.right_px, offset.down_px), (-right, -down), rtol=0, atol=3)
    (warning,) = sensor_warnings([shifted(frame, right, down) for frame in frames])
    assert "px off its depth" in warning and "register the depth to the colour" in warning


def test_a_small_shift_and_no_outlines_say_nothing(frames):
    assert color_offset([shifted(frame, 2) for frame in frames]) is None
    flat = [replace(frame, depth=np.full_like(frame.depth, 1500)) for frame in frames]
    assert color_offset(flat) is None and color_offset([]) is None
    gray = [replace(frame, color=np.full_like(frame.color, 90)) for frame in frames]
    assert color_offset(gray) is None


def test_colour_that_is_mirrored_against_its_depth(frames):
    turned = [replace(frame, color=mirrored(frame).color) for frame in frames]
    assert color_offset(turned).mirrored
    assert sensor_warnings(turned) == ["the colour image looks mirrored against the depth, left to right"]


@pytest.mark.slow
def test_one_mirrored_sensor_of_two(shipped):
    pair = shipped[0]
    assert not looks_mirrored(pair.source, pair.target) and looks_mirrored(mirrored(pair.source), pair.target)
    assert agreeing_matches(pair.source, pair.source) > 500
    warnings = recording_warnings(changed(shipped, "right", mirrored))
    assert warnings[0].startswith("right or left looks mirrored")


@pytest.mark.parametrize("times", UNIT_MISTAKES)
def test_depth_in_a_wrong_unit(frames, times):
    wrong = [replace(frame, depth_scale=frame.depth_scale / times) for frame in frames]
    assert unit_mistake(wrong) == times
    (warning,) = [text for text in sensor_warnings(wrong) if "depth_scale" in text]
    assert f"depth_scale {1000 / times:g} should be 1000" in warning


@pytest.mark.slow
def test_where_no_steps_are_the_known_poses_tell_the_unit(shipped):
    """Metres in floating point, called millimetres."""
    metres = changed(shipped, None, lambda frame: replace(frame, depth=frame.depth_m() * 1.0, depth_scale=1000.0))
    (warning,) = recording_warnings(metres)
    assert warning.startswith("the depth looks 1000 times too small: by the known poses")


def test_depth_that_is_all_nearer_than_cameras_see(shipped):
    """The known poses, which would say by how much, are taken away, and so are the steps of structured light."""

    def scaled(times):
        entries = [replace(entry, T_world_camera=None) for entry in shipped.entries if entry.sensor == "right"][:2]
        alone = replace(shipped, entries=tuple(entries), pairs=(PairEntry(1, 0),))
        depth = lambda frame: (frame.depth_m() * times).astype(np.float32)  # noqa: E731
        return changed(alone, None, lambda frame: replace(frame, depth=depth(frame), depth_scale=1.0))

    median = np.nanmedian(scaled(0.05).entries[0].load().depth_m())
    (warning,) = recording_warnings(scaled(0.05))
    assert warning == (
        f"right: the depth looks several times too small: half of it is nearer than {median:.2g} m and hardly any "
        "beyond 0.5 m, where few depth cameras see; check depth_scale 1"
    )
    assert recording_warnings(scaled(1.0)) == ()


def test_near_things_before_a_far_wall_or_in_one_frame_alone_say_nothing(frames):
    near = replace(frames[0], depth=np.full_like(frames[0].depth, 150))
    assert nearer_than_cameras_see([near, near]) == pytest.approx(0.15)
    wall = near.depth.copy()
    wall[:10] = 2000
    assert nearer_than_cameras_see([replace(near, depth=wall)] * 2) is None
    assert nearer_than_cameras_see([near, replace(near, depth=near.depth * 2)]) is None
    assert nearer_than_cameras_see([]) is None
    assert nearer_than_cameras_see([replace(near, depth=np.zeros_like(near.depth))]) is None


@pytest.mark.slow
@pytest.mark.parametrize("times", [0.4, 5.0])
def test_ways_between_known_poses_that_are_all_too_long_or_short(shipped, times):
    def scaled(i):
        T = shipped[i].T_target_source.copy()
        T[:3, 3] *= times
        return replace(shipped.pairs[i], T_target_source=T)

    warnings = recording_warnings(replace(shipped, pairs=tuple(map(scaled, range(len(shipped))))))
    (warning,) = [text for text in warnings if "ways" in text]
    found = re.match(r"the ways between the known poses look ([0-9.]+) times too (short|long): put right, ", warning)
    assert found is not None and found[2] == ("short" if times < 1.0 else "long")
    assert float(found[1]) == pytest.approx(max(times, 1.0 / times), rel=0.06)


def test_depth_files_that_are_the_same_are_named(tmp_path):
    write_redwood(tmp_path, [np.eye(4)] * 4, PinholeIntrinsics(64, 48, 60.0, 60.0, 31.5, 23.5))
    depths = sorted((tmp_path / "depth").iterdir())
    for i, path in enumerate(depths):
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        image[0, 0] += i
        cv2.imwrite(str(path), image)
    recording = open_recording(tmp_path)
    assert not any("depth files" in text for text in recording_warnings(recording))
    for path in depths[2:]:
        shutil.copyfile(depths[1], path)
    (warning,) = [text for text in recording_warnings(recording) if "depth files" in text]
    assert warning == (
        "camera: the depth files of 00001 and 00002 are the same, byte for byte: a camera that hung, copied files or "
        "nothing measured? leave out what is no frame of its own"
    )
    changed_bytes = bytearray(depths[1].read_bytes())
    changed_bytes[-1] ^= 1
    for path in depths[2:]:  # of one size, and one that is not there
        path.unlink()
    depths[2].write_bytes(changed_bytes)
    assert not any("depth files" in text for text in recording_warnings(recording))


def test_sensors_with_the_same_depth_files_are_named(tmp_path):
    """At the second and the third moment; at the first they differ in their last byte, as much as two sensors may."""
    shutil.copytree(SHIPPED, tmp_path / "copy")
    shutil.copyfile(ROOT / "calibration" / "two_kinects.yaml", tmp_path / "copy" / "two_kinects.yaml")
    left, right = (sorted((tmp_path / "copy" / sensor / "depth").iterdir()) for sensor in ("left", "right"))
    for one, other in zip(left[1:], right[1:], strict=True):
        shutil.copyfile(one, other)
    changed_bytes = bytearray(left[0].read_bytes())
    changed_bytes[-1] ^= 1
    right[0].write_bytes(changed_bytes)
    found = [text for text in recording_warnings(open_recording(tmp_path / "copy")) if "depth files" in text]
    assert found == [
        f"left and right: their depth files of {left[1].stem} are the same, byte for byte: was one camera recorded "
        "twice, were files copied, or was nothing measured?"
    ]


@pytest.mark.parametrize(
    ("step", "apart", "said"),
    [
        (1 / 30, 1 / 60, None),
        (1 / 30, 0.15, "0.15 s"),
        (0.5, 0.25, None),
        (0.5, 0.9, None),
        (60.0, 0.9, None),
        (2.0, -37.5, "37.5 s"),
        (None, 37.5, None),
    ],
)
def test_frames_of_one_moment_that_are_far_apart_in_time(tmp_path, step, apart, said):
    write_redwood(tmp_path, [np.eye(4)] * 3, PinholeIntrinsics(64, 48, 60.0, 60.0, 31.5, 23.5))
    load = open_recording(tmp_path).entries[0].load

    def time(sensor, i):
        return None if step is None else 1e9 + i * step + (apart if sensor == "right" and i == 1 else 0.0)

    entries = [FrameEntry(str(i), s, load, timestamp=time(s, i)) for i in range(3) for s in ("left", "right")]
    pairs = tuple(PairEntry(i + 1, i) for i in range(0, 6, 2))
    warnings = recording_warnings(Recording("times", tmp_path, "adagmm", tuple(entries), pairs))
    expected = (
        f"left and right: their frames of one moment are up to {said} apart by their times: another moment's, or "
        "clocks that differ? what moved in between is at two places"
    )
    assert [text for text in warnings if "moment" in text] == ([expected] if said else [])


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ((440, 360, 495.6, 495.5, 269.5, 169.2), "cx 269.5 is 50 px off the middle of images 440 wide"),
        ((640, 480, 525, 525, 256, 180), "cx 256 is 64 px off the middle of images 640 wide and cy 180 is 60 px off"),
        ((640, 480, 525, 525, 239.5, 319.5), "cx 239.5 cy 319.5 look exchanged, for images of 640x480"),
        ((540, 360, 495, 659, 269.5, 169.2), "fx 495 and fy 659 are of pixels that are not square"),
        # Kinect v1 as TUM calibrated one, Kinect v2, RealSense F200, both sizes of the Azure Kinect's narrow view, and
        # images of which undistorting left the middle.
        ((640, 480, 517.3, 516.5, 318.6, 255.3), None),
        ((512, 424, 365, 365, 256, 212), None),
        ((640, 480, 615.2, 615.2, 298.4, 247.5), None),
        ((640, 576, 504, 504, 320, 345), None),
        ((320, 288, 252, 252, 160, 168), None),
        ((739, 458, 726, 726, 354.6, 186.5), None),
    ],
)
def test_intrinsics_of_other_images(tmp_path, values, said):
    width, height = values[:2]
    write_redwood(tmp_path, [np.eye(4)] * 2, PinholeIntrinsics(width, height, 500.0, 500.0, width / 2, height / 2))
    rig = Rig("mine", {"camera": SensorCalibration("camera", PinholeIntrinsics(*values), 1000.0, None)})
    found = [text for text in recording_warnings(open_recording(tmp_path, rig=rig)) if re.match("camera: [cf]x", text)]
    assert [text.startswith(f"camera: {said}") for text in found] == ([True] if said else [])


def test_intrinsics_that_the_reader_doubts_are_doubted_once(tmp_path):
    write_redwood(tmp_path, [np.eye(4)] * 2, PinholeIntrinsics(64, 48, 60.0, 60.0, 23.5, 31.5))
    recording = open_recording(tmp_path)
    assert "look exchanged" in recording.notes[0]
    assert not any("exchanged" in text or "middle" in text for text in recording_warnings(recording))


def test_disparity_is_no_depth(frames):
    assert not looks_like_disparity(frames) and looks_like_disparity([disparity(frame) for frame in frames])
    assert not looks_like_disparity([])
    assert any("looks like disparity" in text for text in sensor_warnings([disparity(frame) for frame in frames]))


@pytest.mark.slow
def test_info_and_report_say_so(tmp_path, capsys, monkeypatch, shipped):
    wrong = changed(shipped, "right", lambda frame: shifted(frame, 25))
    monkeypatch.setattr("adagmm_fusion.commands.info.recording_of", lambda args: wrong)
    main(["info", str(SHIPPED)])
    assert "note: right: the colour looks " in capsys.readouterr().out
    monkeypatch.setattr("adagmm_fusion.commands.run.open_recording", lambda *_, **__: wrong)
    arguments = ["--pairs", "0", "--no-clouds", "--no-rerun", "--device", "cpu", "--output", str(tmp_path)]
    main(["run", str(SHIPPED), *arguments])
    assert "note: right: the colour looks " in capsys.readouterr().out
    assert "## Notes on the recording\n\n- right: the colour looks " in (tmp_path / "report.md").read_text()


def turned(way, late=0.0):
    """Poses of three frames [m], each turned further and `way` farther on; `late`, by so many degrees more each."""
    return [camera_pose(10.0 * i + late * (i + 1), (0.0, way * i, 1.2), 60.0) for i in range(3)]


def test_poses_of_another_time_are_no_wrong_unit(tmp_path):
    """Over a floor all of which, brought near enough, would be within centimetres of where any such pose has it."""
    write_redwood(tmp_path, turned(0.03), PinholeIntrinsics(160, 120, 131.0, 131.0, 79.5, 59.5))
    recording = open_recording(tmp_path)
    poses = turned(0.03, late=8.0)
    late = [replace(p, T_target_source=se_inverse(poses[p.target]) @ poses[p.source]) for p in recording.pairs]
    assert not any("depth_scale" in text for text in recording_warnings(replace(recording, pairs=tuple(late))))


@pytest.mark.slow
@pytest.mark.parametrize("times", [5.0, 10.0])
def test_depth_that_is_too_large_is_told_by_the_known_poses(shipped, times):
    """In floating point, so that no steps tell."""
    large = lambda frame: replace(frame, depth=frame.depth_m() * 1.0, depth_scale=1.0 / times)  # noqa: E731
    warnings = recording_warnings(changed(replace(shipped, pairs=shipped.pairs[:2]), None, large))
    (warning,) = [text for text in warnings if "depth_scale" in text]
    assert warning.startswith(f"the depth looks {times:g} times too large: by the known poses ")
