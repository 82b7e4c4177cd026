"""RealSense .bag files as librealsense writes them, and what all video files have in common."""

import os
import re

import numpy as np
import open3d as o3d
import pytest
from depth_scene import camera_pose, render
from realsense_bag import write_bag
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from adagmm_fusion.cli import main
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats import video
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration
from adagmm_o3d import lie
from adagmm_o3d.lie import se_inverse

INTRINSICS = PinholeIntrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)
POSES = {"a": camera_pose(-12.0), "b": camera_pose(14.0, (0.1, 0.5, 1.3))}
RIG = Rig("two", {name: SensorCalibration(name, INTRINSICS, 1000.0, pose) for name, pose in POSES.items()})


@pytest.fixture(autouse=True)
def nothing_stays_open():
    video._open.cache_clear()
    yield
    video._open.cache_clear()


def numbered(sensor, number):
    """What a sensor sees, with the number of the frame in the first pixel."""
    color, depth = render(INTRINSICS, POSES[sensor])
    color[0, 0] = number
    return color, np.rint(depth * 4000).astype(np.uint16)


def bag(tmp_path, sensor="a", count=5, **more):
    frames = more.pop("frames", [numbered(sensor, i) for i in range(count)])
    path = tmp_path / f"{sensor}.bag"
    write_bag(path, frames, INTRINSICS, INTRINSICS, **({"fps": 10, "units": 1 / 4000} | more))
    return path


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8"])
def test_one_bag_is_one_moving_sensor(tmp_path, encoding):
    recording = open_recording(bag(tmp_path, color=encoding), step=2)
    assert (recording.name, recording.format, recording.sensors) == ("a", "video", ("a",))
    assert [recording.pair_name(i) for i in range(2)] == ["00000200ms_to_00000000ms", "00000400ms_to_00000200ms"]
    assert recording[0].T_target_source is None
    for number in (3, 0, 4, 1, 2, 2):  # in any order
        frame = recording.frames().frame(number)
        color, depth = numbered("a", number)
        assert frame.intrinsics == INTRINSICS and frame.depth_scale == 4000.0
        assert frame.timestamp == pytest.approx(number / 10, rel=1e-9, abs=1e-9)
        np.testing.assert_array_equal(frame.color, color)
        np.testing.assert_array_equal(frame.depth, depth)


def test_depth_is_registered_to_the_color(tmp_path):
    depth_camera = PinholeIntrinsics(160, 120, 150.0, 151.0, 79.0, 60.0)
    color_camera = PinholeIntrinsics(160, 120, 140.0, 140.0, 79.5, 59.5)
    T_color_depth = lie.se_exp((0.02, -0.03, 0.05, 0.06, 0.01, -0.02))
    pose = camera_pose(5.0)
    color, true_depth = render(color_camera, pose)
    _, depth = render(depth_camera, pose @ T_color_depth)
    path = tmp_path / "a.bag"
    frames = [(color, np.rint(1000 * depth).astype(np.uint16))] * 2
    write_bag(path, frames, depth_camera, color_camera, T_color_depth=T_color_depth)
    frame = open_recording(path).frames().frame(1)
    measured = frame.depth_m()
    known = np.isfinite(measured)
    assert frame.intrinsics == color_camera and known.mean() > 0.85
    assert np.median(np.abs(measured - true_depth)[known]) < 0.005
    assert np.percentile(np.abs(measured - true_depth)[known], 95) < 0.03


def test_such_bags_are_what_librealsense_reads(tmp_path):
    """Open3D's reader, which is librealsense's, tells the same of the file."""
    reader = o3d.t.io.RSBagReader()
    assert reader.open(str(bag(tmp_path)))
    assert (reader.metadata.width, reader.metadata.height, reader.metadata.fps) == (64, 48, 10.0)
    np.testing.assert_allclose(reader.metadata.intrinsics.intrinsic_matrix, INTRINSICS.matrix(), rtol=1e-6, atol=0)
    assert reader.metadata.depth_scale == pytest.approx(4000.0, rel=1e-6)
    image = reader.next_frame()
    number = int(np.asarray(image.color)[0, 0, 0])
    np.testing.assert_array_equal(np.asarray(image.color), numbered("a", number)[0])


def test_lens_distortion_of_opencvs_model_is_told(tmp_path):
    bent = PinholeIntrinsics(64, 48, 60.0, 61.0, 31.5, 23.5, (0.1, -0.05, 0.001, -0.002, 0.0))
    write_bag(tmp_path / "a.bag", [numbered("a", 0)] * 2, INTRINSICS, bent)
    assert open_recording(tmp_path / "a.bag").frames().frame(0).intrinsics == bent


def test_missing_colors(tmp_path):
    frames = [numbered("a", i) for i in range(5)]
    for i in (2, 3, 4):
        frames[i] = (None, frames[i][1])
    recording = open_recording(bag(tmp_path, frames=frames)).frames()
    assert recording.frame(2).color[0, 0, 0] == 1  # the one before is near enough
    with pytest.raises(RecordingError, match=r"a\.bag: the colour nearest to 0\.400 s is 300 ms away"):
        recording.frame(4)


CLOCKS = {
    "a pause": [0.0, 0.1, 2.1, 2.2],
    "an hour on": [0.0, 0.1, 3600.1, 3600.2],
    "116 days on": [0.0, 0.1, 1e7, 1e7 + 0.1],
    "an hour back": [3600.0, 3600.1, 0.05, 0.15],
    "back into times that were there": [0.5, 0.6, 0.5, 0.6],
    "the same time": [0.0, 0.1, 0.1, 0.1],
}


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_frame_for_each_depth_image_whatever_the_clock_says(tmp_path, clock, capsys):
    times = CLOCKS[clock]
    path = bag(tmp_path, count=4, times=times)
    recording = open_recording(path)
    assert len(recording.entries) == 4 and len(recording) == 3
    assert len({entry.name for entry in recording.entries}) == 4
    for number in (2, 0, 3, 1):
        frame = recording.entries[number].load()
        color, depth = numbered("a", number)
        np.testing.assert_array_equal(frame.depth, depth)
        if clock != "the same time":  # any of the colours of that time is right
            np.testing.assert_array_equal(frame.color, color)
        assert frame.timestamp == pytest.approx(times[number] - times[0], rel=1e-9, abs=1e-9)
    assert main(["info", str(path)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert ("pauses or jumps of the clock: 1" in told) == (clock in ("a pause", "an hour on", "116 days on"))
    assert ("clock stands still or is set back: " in told) == ("back" in clock or clock == "the same time")


def test_even_times_are_no_pause(tmp_path, capsys):
    assert main(["info", str(bag(tmp_path))]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "time from frame to frame │ 100 ms" in told and "clock" not in told


def test_frames_that_only_one_sensor_has(tmp_path):
    """A pause of one sensor, and a frame that came late: what belongs together is told by the times."""
    bag(tmp_path, "a", times=[0.0, 0.1, 0.2, 0.3, 0.4])
    bag(tmp_path, "b", times=[0.0, 0.13, 0.31, 0.4, 0.5])
    recording = open_recording(tmp_path)
    together = {}
    for entry in recording.entries:
        together.setdefault(entry.name, {})[entry.sensor] = int(entry.load().color[0, 0, 0])
    assert together == {
        "00000000ms": {"a": 0, "b": 0},
        "00000100ms": {"a": 1, "b": 1},
        "00000200ms": {"a": 2},
        "00000300ms": {"a": 3, "b": 2},
        "00000400ms": {"a": 4, "b": 3},
    }
    assert len(recording) == 4


def test_two_files_are_a_pair_of_sensors_whose_poses_the_rig_knows(tmp_path):
    for sensor in ("b", "a"):
        bag(tmp_path, sensor)
    recording = open_recording(tmp_path, rig=RIG, step=3)
    assert recording.sensors == ("a", "b")
    assert [p.name for p in recording] == ["00000000ms_b_to_a", "00000300ms_b_to_a"]
    expected = se_inverse(POSES["a"]) @ POSES["b"]
    np.testing.assert_allclose(recording[0].T_target_source, expected, rtol=0, atol=1e-15)
    assert open_recording(tmp_path)[0].T_target_source is None


def test_colour_formats_that_are_not_known(tmp_path):
    frames = open_recording(bag(tmp_path, color="yuv422")).frames()
    with pytest.raises(RecordingError, match="expected Color as rgb8, bgr8, rgba8, bgra8, got 'yuv422'"):
        frames.frame(0)


def test_sensors_of_different_frame_rates_are_no_pair(tmp_path):
    bag(tmp_path)
    bag(tmp_path, "b", fps=30)
    with pytest.raises(RecordingError, match=r"b\.bag: 30 frames a second, but a\.bag has 10"):
        open_recording(tmp_path, rig=RIG)


def test_an_mkv_that_is_none_is_one_line(tmp_path):
    (tmp_path / "a.mkv").write_bytes(bytes(1000))
    with pytest.raises(
        RecordingError, match=r"a\.mkv: expected a Matroska file \(\.mkv\), it is something else"
    ) as caught:
        open_recording(tmp_path, rig=RIG)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", [0, 13, 1000, 0.5, 0.9])
def test_a_bag_that_is_cut_off_is_one_line(tmp_path, kept):
    path = bag(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: kept if kept > 1 or kept == 0 else int(kept * len(data))])
    with pytest.raises(RecordingError) as caught:
        open_recording(path)
    assert str(caught.value).startswith(f"{path}: is no ROS bag, or cut off or damaged") and "\n" not in str(
        caught.value
    )


def test_a_bag_whose_cameras_are_nowhere(tmp_path):
    T_color_depth = np.eye(4)
    T_color_depth[0, 3] = np.nan
    path = bag(tmp_path, T_color_depth=T_color_depth)
    with pytest.raises(
        RecordingError, match=rf"^{re.escape(str(path))}: \S+/Color_0/tf/0: pose: expected finite numbers"
    ):
        open_recording(path)


def test_a_bag_of_something_else(tmp_path):
    path = tmp_path / "a.bag"
    types = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as writer:
        connection = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=types)
        text = types.types["std_msgs/msg/String"]("hello")
        writer.write(connection, 1, bytes(types.serialize_ros1(text, "std_msgs/msg/String")))
    with pytest.raises(RecordingError, match=r"a\.bag: expected topics of a camera's colour and depth"):
        open_recording(path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes of POSIX")
@pytest.mark.parametrize("suffix", ["bag", "mkv"])
def test_a_pipe_that_is_called_a_video(tmp_path, suffix):
    """Opened by the libraries it would wait for ever."""
    os.mkfifo(tmp_path / f"a.{suffix}")
    with pytest.raises(RecordingError, match=rf"a\.{suffix}: cannot be read: it is a pipe or a device, not a file"):
        open_recording(tmp_path, rig=RIG)
    with pytest.raises(RecordingError, match=f"a.{suffix}: "):
        open_recording(tmp_path / f"a.{suffix}", format="video", rig=RIG)


def test_no_video_at_all(tmp_path):
    with pytest.raises(RecordingError, match=r"expected an \.mkv or \.bag file"):
        open_recording(tmp_path, format="video")
