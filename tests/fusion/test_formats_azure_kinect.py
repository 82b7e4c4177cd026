"""Azure Kinect recordings without Microsoft's libraries, written as the format's page and Matroska's RFC say."""

import numpy as np
import pytest
from azure_mkv import COLOR_SIZE, DEPTH_SIZE, write_azure_mkv
from depth_scene import camera_pose, render

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
