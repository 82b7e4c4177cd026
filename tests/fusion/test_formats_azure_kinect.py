"""Azure Kinect recordings without Microsoft's libraries, written as the format's page and Matroska's RFC say."""

import numpy as np
import pytest
from azure_mkv import COLOR_SIZE, DEPTH_SIZE, write_azure_mkv
from depth_scene import camera_pose, render

from adagmm_fusion.cli import main
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats import video
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.errors import AdaGMMError

COLOR = PinholeIntrinsics(*COLOR_SIZE, 608.0, 607.0, 638.0, 366.0, (0.08, -0.05, 0.0004, -0.0002, 0.01, 0.0, 0.0, 0.0))
DEPTH = PinholeIntrinsics(*DEPTH_SIZE, 252.0, 252.5, 161.0, 167.0)
T_COLOR_DEPTH = camera_pose(90.0, (-0.032, -0.002, 0.004), 0.0)
T_COLOR_DEPTH[:3, :3] = np.eye(3)
POSES = [camera_pose(-6.0), camera_pose(0.0), camera_pose(5.0)]
FRAMES = [
    (render(COLOR, pose)[0], np.rint(1000 * render(DEPTH, pose @ T_COLOR_DEPTH)[1]).astype(np.uint16)) for pose in POSES
]


@pytest.fixture(autouse=True)
def nothing_stays_open():
    video._open.cache_clear()
    yield
    video._open.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["MJPG", "NV12"])
def test_a_recording_is_read_with_its_own_calibration(tmp_path, codec):
    write_azure_mkv(tmp_path / "desk.mkv", FRAMES, COLOR, DEPTH, T_COLOR_DEPTH, codec=codec)
    recording = open_recording(tmp_path / "desk.mkv")
    assert recording.format == "video" and len(recording.entries) == 3
    for i, (entry, pose) in enumerate(zip(recording.entries, POSES, strict=True)):
        frame = entry.load()
        np.testing.assert_allclose(frame.intrinsics.matrix(), COLOR.matrix(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(frame.intrinsics.distortion, COLOR.distortion, rtol=0, atol=1e-12)
        assert frame.depth_scale == 1000.0 and frame.timestamp == pytest.approx(i / 30, rel=0, abs=1e-3)
        assert np.abs(frame.color.astype(int) - FRAMES[i][0]).mean() < 4.0
        off = np.abs(frame.depth_m() - render(COLOR, pose)[1])
        assert np.isfinite(off).mean() > 0.5 and np.nanpercentile(off, 95) < 0.02


@pytest.mark.slow
def test_a_capture_that_lacks_an_image_is_left_out_and_said(tmp_path, capsys):
    """Neither is another capture's image taken in its place, nor a capture shown twice."""
    (first, depth), (second, _), (third, last) = FRAMES
    captures = [(first, depth), (None, FRAMES[1][1]), (second, None), (third, last), (None, None), (first, depth)]
    write_azure_mkv(tmp_path / "desk.mkv", captures, COLOR, DEPTH, T_COLOR_DEPTH)
    recording = open_recording(tmp_path / "desk.mkv")
    assert [round(30 * entry.load().timestamp) for entry in recording.entries] == [0, 3, 5]
    for entry, color in zip(recording.entries, (first, third, first), strict=True):
        assert np.abs(entry.load().color.astype(int) - color).mean() < 4.0
    assert main(["info", str(tmp_path / "desk.mkv")]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "1 depth images without colour of the same capture: left out" in told
    assert "1 colour images without depth of the same capture: left out" in told


@pytest.mark.parametrize("delay_ms", [0, 12, 20])
def test_depth_that_is_late_by_intent(tmp_path, delay_ms):
    write_azure_mkv(tmp_path / "desk.mkv", FRAMES, COLOR, DEPTH, T_COLOR_DEPTH, depth_delay_ms=delay_ms)
    recording = open_recording(tmp_path / "desk.mkv")
    assert len(recording.entries) == 3 and not recording.notes
    for entry, (color, _) in zip(recording.entries, FRAMES, strict=True):
        assert np.abs(entry.load().color.astype(int) - color).mean() < 4.0


def test_a_delay_that_is_none(tmp_path):
    path = tmp_path / "desk.mkv"
    write_azure_mkv(path, FRAMES[:1], COLOR, DEPTH, T_COLOR_DEPTH, depth_delay_ms=12)
    path.write_bytes(path.read_bytes().replace(b"12000000", b"1200000x"))
    with pytest.raises(RecordingError, match="K4A_DEPTH_DELAY_NS: expected nanoseconds, got '1200000x'"):
        open_recording(path)


def test_no_capture_at_all(tmp_path):
    write_azure_mkv(
        tmp_path / "desk.mkv",
        [(FRAMES[0][0], None)] + [(None, None)] * 30 + [(None, FRAMES[0][1])],
        COLOR,
        DEPTH,
        T_COLOR_DEPTH,
    )
    with pytest.raises(RecordingError, match=r"no depth image has a colour image within 17 ms of it"):
        open_recording(tmp_path / "desk.mkv")


@pytest.mark.slow
def test_damage_is_an_error_of_ours(tmp_path):
    write_azure_mkv(tmp_path / "desk.mkv", FRAMES[:2], COLOR, DEPTH, T_COLOR_DEPTH)
    data, rng = (tmp_path / "desk.mkv").read_bytes(), np.random.default_rng(5)
    for number in range(40):
        damaged = bytearray(data[: rng.integers(len(data))] if number % 4 == 0 else data)
        for at in rng.integers(0, min(len(damaged), 3000 if number % 2 else len(damaged)) or 1, 10):
            damaged[at : at + 1] = bytes([rng.integers(256)])
        path = tmp_path / f"damaged{number}.mkv"
        path.write_bytes(damaged)
        try:
            open_recording(path).entries[0].load()
        except AdaGMMError as problem:
            assert "\n" not in str(problem)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"calibration.json", b"somethingelse.js", "the calibration is not attached"),
        (b"b16g", b"b64a", "expected colour as MJPG, NV12 or YUY2 and depth as b16g, got 'MJPG' and 'b64a'"),
        (b"CameraPurposeDepth", b"CameraPurposeDepht", "expected a camera of the purpose Depth, there is none"),
        (b'"Rotation"', b'"Rotatino"', "Rt: expected 9 finite numbers, got nothing"),
        (b"DEPTH", b"DEPHT", "there is no image in its track DEPTH"),
    ],
)
def test_what_is_missing_is_said(tmp_path, old, new, match):
    path = tmp_path / "desk.mkv"
    write_azure_mkv(path, FRAMES[:1] * 2, COLOR, DEPTH, T_COLOR_DEPTH)
    data = path.read_bytes()
    assert old in data
    # The attachment's name, not the tag's, and the colour camera's pose.
    where = data.rindex(old) if old in (b"calibration.json", b'"Rotation"') else data.index(old)
    path.write_bytes(data[:where] + new + data[where + len(old) :])
    with pytest.raises(RecordingError, match=match):
        open_recording(path)
