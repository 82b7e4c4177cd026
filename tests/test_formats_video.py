"""Video files: what Open3D's real readers say to broken files, and the frames of stand-ins that answer as they do.

The stand-ins replace the two reader classes only, which need a camera's recording of hundreds of megabytes.
"""

from types import SimpleNamespace

import numpy as np
import open3d as o3d
import pytest
from depth_scene import camera_pose, render

from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.formats import video
from adagmm_fusion.frames import PinholeIntrinsics, inverse_rigid
from adagmm_fusion.recording import open_recording
from adagmm_fusion.rig import Rig, SensorCalibration

INTRINSICS = PinholeIntrinsics(64, 48, 60.0, 61.0, 31.5, 23.5)
POSES = {"a": camera_pose(-12.0), "b": camera_pose(14.0, (0.1, 0.5, 1.3))}
RIG = Rig("two", {name: SensorCalibration(name, INTRINSICS, 1000.0, pose) for name, pose in POSES.items()})


@pytest.fixture(autouse=True)
def nothing_stays_open():
    video._open.cache_clear()
    yield
    video._open.cache_clear()


class FakeBag:
    """o3d.t.io.RSBagReader over five frames at 10 a second, each 2 ms late; the third has no depth."""

    format, fps = "BGR8", 10.0

    def open(self, path):
        self.sensor = path.rsplit("/", 1)[1][0]
        self.metadata = SimpleNamespace(
            width=64,
            height=48,
            fps=self.fps,
            depth_scale=4000.0,
            color_format=self.format,
            stream_length_usec=500_000,
            intrinsics=o3d.camera.PinholeCameraIntrinsic(64, 48, 60.0, 61.0, 31.5, 23.5),
        )
        return True

    def seek_timestamp(self, microseconds):
        if microseconds >= self.metadata.stream_length_usec:
            return False
        self.index = -(-microseconds // 100_000)
        return True

    def is_eof(self):
        return self.index >= 5

    def next_frame(self):
        color, depth = render(INTRINSICS, POSES[self.sensor])
        color[0, 0] = self.index
        color = np.ascontiguousarray(color[:, :, ::-1])
        depth = np.rint(depth * 4000).astype(np.uint16)[:, :, None]
        image = o3d.t.geometry.RGBDImage(o3d.t.geometry.Image(color), o3d.t.geometry.Image(depth))
        if self.index == 2:
            image = SimpleNamespace(color=image.color, depth=o3d.t.geometry.Image())
        self.index += 1
        return image

    def get_timestamp(self):
        return 100_000 * (self.index - 1) + 2_000


class FakeMKV:
    """o3d.io.AzureKinectMKVReader over nine captures at 30 a second; every second one lacks an image and is None."""

    def open(self, path):
        self.sensor = path.rsplit("/", 1)[1][0]
        return True

    def get_metadata(self):
        return SimpleNamespace(width=64, height=48, stream_length_usec=300_000)

    def seek_timestamp(self, microseconds):
        self.index = round(microseconds * 30 / 1e6)
        return True

    def is_eof(self):
        return self.index >= 9

    def next_frame(self):
        self.index += 1
        if self.index % 2 == 0:
            return None
        color, depth = render(INTRINSICS, POSES[self.sensor])
        stored = np.rint(depth * 1000).astype(np.uint16)
        return SimpleNamespace(color=o3d.geometry.Image(color), depth=o3d.geometry.Image(stored))


@pytest.fixture
def fakes(monkeypatch):
    monkeypatch.setattr(o3d.t.io, "RSBagReader", FakeBag)
    monkeypatch.setattr(o3d.io, "AzureKinectMKVReader", FakeMKV)


def files(tmp_path, *names):
    for name in names:
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def test_one_bag_is_one_moving_sensor(fakes, tmp_path):
    recording = open_recording(files(tmp_path, "a.bag") / "a.bag", step=2)
    assert (recording.name, recording.format, recording.sensors) == ("a", "video", ("a",))
    assert [recording.pair_name(i) for i in range(2)] == ["00000200ms_to_00000000ms", "00000400ms_to_00000200ms"]
    frame = recording.frames().frame(1)
    color, depth = render(INTRINSICS, POSES["a"])
    assert frame.intrinsics == INTRINSICS and frame.depth_scale == 4000.0
    assert frame.timestamp == pytest.approx(0.102, rel=1e-12, abs=0)
    assert frame.color[0, 0].tolist() == [1, 1, 1] and np.array_equal(frame.color[1:], color[1:])
    np.testing.assert_allclose(frame.depth_m(), depth, rtol=1e-6, atol=0.51 / 4000)
    assert recording[0].T_target_source is None


def test_a_frame_without_depth_gives_way_to_the_next_one(fakes, tmp_path):
    frames = open_recording(files(tmp_path, "a.bag")).frames()
    assert frames.frame(2).color[0, 0, 0] == 3 and frames.frame(2).timestamp == pytest.approx(0.302, rel=1e-12, abs=0)


def test_two_files_are_a_pair_of_sensors_whose_poses_the_rig_knows(fakes, tmp_path):
    folder = files(tmp_path, "b.bag", "a.bag")
    recording = open_recording(folder, rig=RIG, step=3)
    assert recording.sensors == ("a", "b")
    assert [p.name for p in recording] == ["00000000ms_b_to_a", "00000300ms_b_to_a"]
    expected = inverse_rigid(POSES["a"]) @ POSES["b"]
    np.testing.assert_allclose(recording[0].T_target_source, expected, rtol=0, atol=1e-15)
    assert open_recording(folder)[0].T_target_source is None


def test_mkv_needs_a_rig_for_its_intrinsics(fakes, tmp_path):
    folder = files(tmp_path, "a.mkv", "b.mkv")
    with pytest.raises(RecordingError, match=r"a\.mkv: the intrinsics of a are not known here; give a rig"):
        open_recording(folder)
    with pytest.raises(RigError, match="no sensor 'b'"):
        open_recording(folder, rig=Rig("x", {k: SensorCalibration(k, INTRINSICS, 1000.0, None) for k in ("a", "c")}))
    recording = open_recording(folder, rig=RIG)
    assert len(recording) == 9
    color, depth = render(INTRINSICS, POSES["b"])
    source = recording[1].source
    assert np.array_equal(source.color, color) and source.timestamp == pytest.approx(1 / 30, rel=1e-12, abs=0)
    np.testing.assert_allclose(source.depth_m(), depth, rtol=1e-6, atol=0.51e-3)


def test_end_of_the_file(fakes, tmp_path, monkeypatch):
    frames = open_recording(files(tmp_path, "a.bag")).frames()
    monkeypatch.setattr(FakeBag, "is_eof", lambda self: True)
    with pytest.raises(RecordingError, match=r"a\.bag: no frame with colour and depth at 0\.400 s or later"):
        frames.frame(4)


def test_colour_formats_that_are_not_known(fakes, tmp_path, monkeypatch):
    monkeypatch.setattr(FakeBag, "format", "YUYV")
    with pytest.raises(RecordingError, match="expected colour as RGB8, BGR8, RGBA8, BGRA8, got YUYV"):
        open_recording(files(tmp_path, "a.bag"))


def test_sensors_of_different_frame_rates_are_no_pair(fakes, tmp_path):
    with pytest.raises(RecordingError, match=r"b\.mkv: 30 frames a second, but a\.bag has 10"):
        open_recording(files(tmp_path, "a.bag", "b.mkv"), rig=RIG)


@pytest.mark.parametrize("name", ["a.bag", "a.mkv"])
def test_the_real_readers_errors_are_one_line(tmp_path, name, capfd):
    (tmp_path / name).write_bytes(b"#ROSBAG V2.0\n" + bytes(1000))
    with pytest.raises(RecordingError, match=r"Open3D can(not open it|not read such files here)") as caught:
        open_recording(tmp_path, rig=RIG)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / name)) and "\n" not in message and "\x1b" not in message
    assert capfd.readouterr().err == ""


def test_a_build_of_open3d_without_the_reader(tmp_path, monkeypatch):
    monkeypatch.delattr(o3d.t.io, "RSBagReader")
    with pytest.raises(RecordingError, match=r"a\.bag: this build of Open3D has no reader for it"):
        open_recording(files(tmp_path, "a.bag"))


def test_the_real_readers_have_what_the_stand_ins_have():
    for real, fake in ((o3d.t.io.RSBagReader, FakeBag), (o3d.io.AzureKinectMKVReader, FakeMKV)):
        methods = [name for name in vars(fake) if callable(getattr(fake, name)) and not name.startswith("_")]
        assert "next_frame" in methods and all(hasattr(real, name) for name in methods)
    assert not hasattr(o3d.io.AzureKinectMKVReader, "get_timestamp")
    names = ("width", "height", "fps", "depth_scale", "color_format", "stream_length_usec", "intrinsics")
    assert all(hasattr(o3d.t.io.RGBDVideoMetadata, name) for name in names)
    assert hasattr(o3d.t.io.RSBagReader, "metadata")


def test_no_video_at_all(tmp_path):
    with pytest.raises(RecordingError, match=r"expected an \.mkv or \.bag file"):
        open_recording(tmp_path, format="video")
