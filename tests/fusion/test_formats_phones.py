"""Phones with LiDAR: coarse depth drawn out over colour, ARKit's axes, and confidence."""

import json
import zipfile

import cv2
import numpy as np
import pytest
from depth_scene import camera_pose, render
from folder_layouts import write_polycam, write_record3d, write_scanner_app, write_stray

from adagmm_fusion.clouds.building import dense_cloud
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.lzfse import decoded_lzfse
from adagmm_fusion.formats import record3d
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.extrinsics import extrinsics_notes

PHONE = PinholeIntrinsics(640, 480, 560.0, 560.0, 318.0, 242.0)
POSES = [camera_pose(yaw, (0.05 * i, 0.1 * i, 1.2 + 0.02 * i)) for i, yaw in enumerate((-8.0, 2.0, 9.0))]
WRITERS = {"stray": write_stray, "polycam": write_polycam, "scanner-app": write_scanner_app, "record3d": write_record3d}


@pytest.fixture(scope="module", params=WRITERS)
def phone(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    WRITERS[request.param](folder, POSES, PHONE)
    return request.param, folder


def test_depth_and_colour_are_on_one_grid(phone):
    """160 x 120 pixels of depth become 320 x 240 of a colour image of 640 x 480."""
    format, folder = phone
    recording = open_recording(folder)
    assert recording.format == format and len(recording.entries) == 3 and recording.sensors == ("phone",)
    for entry, pose in zip(recording.entries, POSES, strict=True):
        frame = entry.load()
        color, depth = render(frame.intrinsics, pose)
        assert frame.depth.shape == (240, 320)
        assert frame.intrinsics == PinholeIntrinsics(320, 240, 280.0, 280.0, 158.75, 120.75)
        metres = frame.depth_m()
        assert np.isnan(metres[:14, :14]).all() and np.isnan(metres[-6:, -6:]).all()
        off = np.abs(metres - depth)
        assert np.isfinite(off).mean() > 0.97 and np.nanpercentile(off, 97) < 0.01
        assert np.abs(frame.color.astype(int) - color)[3:-3, 3:-3].mean() < 3.0
        assert len(dense_cloud(frame).points) > 0.9 * depth.size


def test_poses_are_ours(phone):
    recording = open_recording(phone[1])
    for entry, pose in zip(recording.entries, POSES, strict=True):
        np.testing.assert_allclose(entry.T_world_camera, pose, rtol=0, atol=1e-6)
    times = np.array([entry.timestamp for entry in recording.entries])
    assert (np.diff(times) > 0).all() and (np.diff(times) <= 0.5 + 1e-9).all()
    assert extrinsics_notes(recording) == ()


def test_the_video_of_stray_scanner_is_read_in_any_order(tmp_path):
    write_stray(tmp_path, POSES, PHONE, video=True)
    entries = open_recording(tmp_path).entries
    for i in (2, 0, 1, 2):
        frame = entries[i].load()
        assert np.abs(frame.color.astype(int) - render(frame.intrinsics, POSES[i])[0]).mean() < 12.0
    (tmp_path / "rgb.mp4").write_bytes((tmp_path / "rgb.mp4").read_bytes()[:500])
    with pytest.raises(RecordingError, match=r"rgb\.mp4: OpenCV cannot open it"):
        open_recording(tmp_path.rename(tmp_path.with_name("cut")))


def test_polycams_corrected_poses_come_first(tmp_path):
    write_polycam(tmp_path, POSES, PHONE)
    keyframes = tmp_path / "keyframes"
    (keyframes / "images").rename(keyframes / "corrected_images")
    (keyframes / "corrected_cameras").mkdir()
    for path in (keyframes / "cameras").iterdir():
        values = json.loads(path.read_text())
        (keyframes / "corrected_cameras" / path.name).write_text(json.dumps(values | {"t_03": values["t_03"] + 1.0}))
    moved = open_recording(keyframes).entries[0].T_world_camera
    np.testing.assert_allclose(moved[:3, 3], POSES[0][:3, 3] + (1.0, 0.0, 0.0), rtol=0, atol=1e-9)


@pytest.mark.slow
def test_record3d_as_an_archive(tmp_path):
    write_record3d(tmp_path / "inside", POSES, PHONE)
    with zipfile.ZipFile(tmp_path / "scan.r3d", "w") as archive:
        for path in sorted((tmp_path / "inside").rglob("*")):
            archive.write(path, path.relative_to(tmp_path / "inside"))
    for place in (tmp_path / "scan.r3d", tmp_path):
        recording = open_recording(place)
        assert recording.format == "record3d" and np.isfinite(recording[0].source.depth_m()).mean() > 0.9
    data = (tmp_path / "scan.r3d").read_bytes()
    rng = np.random.default_rng(0)
    for number in range(60):
        damaged = bytearray(data[: rng.integers(len(data))] if number % 2 else data)
        for at in rng.integers(0, max(len(damaged), 1), 30):
            damaged[at : at + 1] = b"\xff"
        (tmp_path / f"damaged{number}.r3d").write_bytes(damaged)
        try:
            for entry in open_recording(tmp_path / f"damaged{number}.r3d").entries:
                entry.load()
        except RecordingError as problem:
            assert f"damaged{number}" in str(problem) and "\n" not in str(problem)


def test_the_members_of_an_archive_are_listed_once(tmp_path, monkeypatch):
    """Not for each frame: of a scan of minutes there are tens of thousands. A file that has changed is opened anew."""
    write_record3d(tmp_path / "inside", POSES, PHONE)
    opened, Archive = [], zipfile.ZipFile

    class Counting(Archive):
        def __init__(self, file):
            opened.append(file)
            super().__init__(file)

    monkeypatch.setattr(record3d.zipfile, "ZipFile", Counting)
    for times in (1, 2):
        with Archive(tmp_path / "scan.r3d", "w") as archive:
            for path in sorted((tmp_path / "inside").rglob("*")):
                archive.write(path, path.relative_to(tmp_path / "inside"))
            archive.writestr("more", b"x" * times)
        opened.clear()
        for entry in open_recording(tmp_path / "scan.r3d").entries:
            entry.load()
        assert opened == [tmp_path / "scan.r3d"]


def test_intrinsics_of_each_frame_of_record3d(tmp_path):
    write_record3d(tmp_path, POSES, PHONE)
    metadata = json.loads((tmp_path / "metadata").read_text())
    metadata["perFrameIntrinsicCoeffs"] = [[560.0 + i, 560.0 + i, 318.0, 242.0] for i in range(3)]
    (tmp_path / "metadata").write_text(json.dumps(metadata))
    assert [entry.load().intrinsics.fx for entry in open_recording(tmp_path).entries] == [280.0, 280.5, 281.0]


def test_lzfse():
    stored = b"bvx-\x03\0\0\0abcbvx-\x02\0\0\0debvx$"
    assert decoded_lzfse(stored, 5, "x") == b"abcde" and decoded_lzfse(b"abcde", 5, "x") == b"abcde"
    for data in (stored[:-4], stored[:9], b"", b"bvx$", b"nonsense"):
        with pytest.raises(RecordingError, match=r"^x: "):
            decoded_lzfse(data, 5, "x")


def test_lzfse_that_is_compressed():
    liblzfse = pytest.importorskip("liblzfse", reason="pyliblzfse is not installed")
    data = np.linspace(0, 3, 5000, dtype="<f4").tobytes()
    assert decoded_lzfse(liblzfse.compress(data), len(data), "x") == data


@pytest.mark.parametrize(
    ("write", "file", "old", "new", "match"),
    [
        (write_stray, "odometry.csv", "000001, ", "000001, 7, ", r"odometry\.csv:3: expected timestamp, frame, x"),
        (write_stray, "camera_matrix.csv", "560.0, 0.0", "560.0", r"camera_matrix\.csv:1: expected 3 numbers"),
        (write_polycam, "keyframes/cameras/10000000.json", '"fx"', '"f"', "fx: expected a finite number, got nothing"),
        (write_scanner_app, "frame_00000.json", '"intrinsics"', '"K"', "intrinsics: expected 9 finite numbers"),
        (write_record3d, "metadata", '"poses"', '"pose"', "poses: expected a list of poses"),
        (write_record3d, "metadata", '"w": 640', '"w": -640', "expected sizes w, h, dw, dh in pixels"),
    ],
)
def test_mistakes_are_named(tmp_path, write, file, old, new, match):
    write(tmp_path, POSES, PHONE)
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    with pytest.raises(RecordingError, match=match):
        open_recording(tmp_path)


def test_a_confidence_image_of_another_size(tmp_path):
    write_stray(tmp_path, POSES, PHONE)
    assert cv2.imwrite(str(tmp_path / "confidence/000000.png"), np.ones((4, 5), np.uint8))
    with pytest.raises(RecordingError, match=r"000000\.png: expected \(120, 160\) pixels of confidence"):
        open_recording(tmp_path).entries[0].load()
