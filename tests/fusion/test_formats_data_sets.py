"""What is special about single data sets: two cameras, lost tracking, intrinsics of each frame, trimmed copies."""

import json

import numpy as np
import pytest
from depth_scene import camera_pose, render
from folder_layouts import (
    write_bop,
    write_color,
    write_depth,
    write_icl_nuim,
    write_nerfstudio,
    write_replica,
    write_scannet,
    write_sens,
)

from adagmm_fusion.errors import RecordingError
from adagmm_fusion.formats.icl_nuim import INTRINSICS as ICL
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording

SMALL = PinholeIntrinsics(160, 120, 140.0, 141.0, 79.0, 60.5)
FINE = PinholeIntrinsics(320, 240, 270.0, 272.0, 161.5, 118.5)
T_COLOR_DEPTH = np.array([[1.0, 0, 0, 0.04], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
POSES = [camera_pose(yaw, (0.05 * i, 0.1 * i, 1.2)) for i, yaw in enumerate((-8.0, 2.0, 9.0))]


def registered(frame, pose):
    off = np.abs(frame.depth_m() - render(frame.intrinsics, pose)[1])
    assert frame.intrinsics == FINE and np.isfinite(off).mean() > 0.8 and np.nanpercentile(off, 95) < 0.02


def test_a_sens_file_of_two_cameras(tmp_path):
    write_sens(tmp_path, POSES, FINE, SMALL, T_COLOR_DEPTH)
    for place in (tmp_path, tmp_path / "scene.sens"):
        registered(open_recording(place)[0].source, POSES[1])
    data = (tmp_path / "scene.sens").read_bytes()
    (tmp_path / "scene.sens").write_bytes(data[:-10])
    with pytest.raises(RecordingError, match="is cut off in frame 2 of 3"):
        open_recording(tmp_path)
    (tmp_path / "scene.sens").write_bytes(b"\x05" + data[1:])
    with pytest.raises(RecordingError, match=r"expected a \.sens file of version 4, got 5"):
        open_recording(tmp_path)


def test_scannet_with_finer_colour_of_another_camera(tmp_path):
    write_scannet(tmp_path, POSES, SMALL)
    for i, pose in enumerate(POSES):
        write_color(tmp_path / f"color/{i}.png", FINE, pose)
        write_depth(tmp_path / f"depth/{i}.png", SMALL, pose @ T_COLOR_DEPTH, 1000)
    np.savetxt(tmp_path / "intrinsic/intrinsic_color.txt", FINE.matrix())
    np.savetxt(tmp_path / "intrinsic/extrinsic_depth.txt", T_COLOR_DEPTH)
    registered(open_recording(tmp_path)[0].source, POSES[1])


def test_scannet_with_the_depths_intrinsics_alone_and_lost_tracking(tmp_path):
    write_scannet(tmp_path, POSES, SMALL)
    (tmp_path / "intrinsic/intrinsic_color.txt").unlink()
    (tmp_path / "pose/1.txt").write_text("-inf -inf -inf -inf\n" * 4)
    (tmp_path / "pose/2.txt").unlink()
    entries = open_recording(tmp_path).entries
    assert entries[0].load().intrinsics == SMALL
    assert [entry.T_world_camera is None for entry in entries] == [False, True, True]


def test_icl_nuim_trimmed_and_without_a_pose_for_its_first_frame(tmp_path):
    write_icl_nuim(tmp_path, POSES, ICL)
    lines = (tmp_path / "associations.txt").read_text()
    (tmp_path / "associations.txt").write_text("0 rgb/0.png 0 depth/0.png\n" + lines)
    write_color(tmp_path / "rgb/0.png", ICL, POSES[0])
    write_depth(tmp_path / "depth/0.png", ICL, POSES[0], 5000)
    for kind in ("rgb", "depth"):
        (tmp_path / kind / "2.png").unlink()
    entries = open_recording(tmp_path).entries
    assert [entry.name for entry in entries] == ["0", "1", "3"] and entries[0].T_world_camera is None
    assert entries[0].load().color.shape == (480, 640, 3)


def test_bop_has_intrinsics_for_each_image_and_not_always_poses(tmp_path):
    write_bop(tmp_path, POSES, SMALL)
    cameras = json.loads((tmp_path / "scene_camera.json").read_text())
    cameras["1"]["cam_K"][0] = 150.0
    del cameras["2"]["cam_R_w2c"]
    (tmp_path / "scene_camera.json").write_text(json.dumps(cameras))
    entries = open_recording(tmp_path).entries
    assert [entry.load().intrinsics.fx for entry in entries] == [140.0, 150.0, 140.0]
    assert entries[1].T_world_camera is not None and entries[2].T_world_camera is None


def test_replica_without_its_parameters_is_as_it_was_rendered(tmp_path):
    write_replica(tmp_path / "room0", POSES, SMALL)
    (tmp_path / "room0/cam_params.json").rename(tmp_path / "cam_params.json")
    assert open_recording(tmp_path / "room0").entries[0].load().intrinsics == SMALL
    (tmp_path / "cam_params.json").unlink()
    with pytest.raises(RecordingError, match="the intrinsics are for 1200x680 pixels"):
        open_recording(tmp_path / "room0").entries[0].load()


def transforms(folder, **changes):
    values = json.loads((folder / "transforms.json").read_text()) | changes
    (folder / "transforms.json").write_text(json.dumps(values))


def test_nerfstudio_lenses_units_and_frames_of_their_own(tmp_path):
    write_nerfstudio(tmp_path, POSES, SMALL)
    frames = json.loads((tmp_path / "transforms.json").read_text())["frames"]
    del frames[2]["depth_file_path"]
    frames[1]["fl_x"] = 150.0
    frames[0]["file_path"] = frames[0]["file_path"].removesuffix(".png")
    transforms(tmp_path, frames=frames, k1=0.1, depth_unit_scale_factor=0.002)
    recording = open_recording(tmp_path)
    assert recording.notes == ("left out, without depth: 1 of 3 frames",)
    first, second = (entry.load() for entry in recording.entries)
    assert first.intrinsics.distortion == (0.1, 0.0, 0.0, 0.0) and first.depth_scale == 500.0
    assert (first.intrinsics.fx, second.intrinsics.fx) == (140.0, 150.0)


def test_instant_ngps_depth_unit_counts(tmp_path):
    write_nerfstudio(tmp_path, POSES[:2], SMALL)
    transforms(tmp_path, integer_depth_scale=0.0002, is_fisheye=False)
    assert open_recording(tmp_path).entries[0].load().depth_scale == pytest.approx(5000.0, rel=1e-12)


@pytest.mark.parametrize(
    ("suffix", "dtype", "scale"), [(".PNG", np.uint16, 1000.0), (".npy", np.uint16, 1000.0), (".npy", np.float32, 1.0)]
)
def test_nerfstudios_depth_without_a_unit_is_in_millimetres_if_its_numbers_are_whole(tmp_path, suffix, dtype, scale):
    write_nerfstudio(tmp_path, POSES[:2], SMALL)
    document = json.loads((tmp_path / "transforms.json").read_text())
    document.pop("depth_unit_scale_factor", None)
    for frame in document["frames"]:
        old = tmp_path / frame["depth_file_path"]
        new = old.with_suffix(suffix)
        if suffix == ".npy":
            np.save(new, np.full((SMALL.height, SMALL.width), 2 * scale, dtype))
        else:
            old.rename(new)
        frame["depth_file_path"] = str(new.relative_to(tmp_path))
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    frame = open_recording(tmp_path).entries[1].load()
    assert frame.depth_scale == scale and 0.3 < float(np.nanmedian(frame.depth_m())) < 10.0


def test_nerfstudios_view_in_radians_scaled_poses_and_paths_from_the_root(tmp_path):
    write_nerfstudio(tmp_path, POSES, SMALL)
    poses = [entry.T_world_camera for entry in open_recording(tmp_path).entries]
    document = json.loads((tmp_path / "transforms.json").read_text())
    angle = 2.0 * np.arctan(0.5 * SMALL.width / document.pop("fl_x"))
    for name in ("fl_y", "cx", "cy"):
        del document[name]
    for frame in document["frames"]:
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [[1, 1, 1, 0.25]]).tolist()
        frame["transform_matrix"][3][3] = 1.0
        frame["depth_file_path"] = str(tmp_path.resolve() / frame["depth_file_path"])
    (tmp_path / "transforms.json").write_text(json.dumps(document | {"camera_angle_x": angle, "applied_scale": 0.25}))
    recording = open_recording(tmp_path)
    assert recording.notes == ("the poses' places are divided by the file's applied_scale, 0.25",)
    intrinsics = recording.entries[0].load().intrinsics
    assert intrinsics.fx == intrinsics.fy == pytest.approx(SMALL.fx, rel=1e-12)
    assert (intrinsics.cx, intrinsics.cy) == (0.5 * (SMALL.width - 1), 0.5 * (SMALL.height - 1))
    for entry, pose in zip(recording.entries, poses, strict=True):
        np.testing.assert_allclose(entry.T_world_camera, pose, rtol=0, atol=1e-9)


def test_the_size_of_nerfstudios_images_is_that_of_the_first_that_can_be_read(tmp_path):
    write_nerfstudio(tmp_path, POSES, SMALL)
    document = json.loads((tmp_path / "transforms.json").read_text())
    del document["w"], document["h"]
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    (tmp_path / document["frames"][0]["file_path"]).write_bytes(b"")
    recording = open_recording(tmp_path)
    with pytest.raises(RecordingError, match="expected a PNG or JPEG image, it is empty"):
        recording.entries[0].load()
    assert recording.entries[1].load().intrinsics == SMALL


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "camera_model: expected OPENCV or PINHOLE, got 'OPENCV_FISHEYE'"),
        ({"frames": {}}, "frames: expected a list of frames"),
        ({"frames": []}, "no frame has depth_file_path"),
        ({"fl_x": "x"}, "fl_x: expected a finite number, got 'x'"),
        ({"depth_unit_scale_factor": 0}, "expected metres a unit, got 0"),
        ({"k1": 0.1, "k9": 3.0, "dist9": 2.0}, "dist9: this lens distortion is not understood"),
        ({"is_fisheye": True, "k1": 0.1}, "isfisheye: expected plumb_bob or rational_polynomial, got True"),
        ({"applied_scale": 0}, "applied_scale: expected a positive number, got 0"),
        ({"fl_x": 0.92}, "fx: expected pixels, got 0.92 for a width of 160; were they divided by the image's"),
        ({"k1": 0.1, "k4": 0.01}, "k4: expected 0, OpenCV's k4 means something else"),
    ],
)
def test_nerfstudio_mistakes(tmp_path, changes, match):
    write_nerfstudio(tmp_path, POSES[:2], SMALL)
    transforms(tmp_path, **changes)
    with pytest.raises(RecordingError, match=match):
        open_recording(tmp_path)


@pytest.mark.parametrize(
    ("write", "file", "old", "new", "match"),
    [
        (write_bop, "scene_camera.json", '"1"', '"one"', "expected the numbers of images, got 'one'"),
        (write_bop, "scene_camera.json", '"cam_K": [140.0, ', '"cam_K": [', "1?: cam_K: expected 9 finite numbers"),
        (
            write_bop,
            "scene_camera.json",
            '"depth_scale": 0.1',
            '"depth_scale": 0',
            "expected millimetres a unit, got 0",
        ),
        (write_replica, "cam_params.json", '"fx"', '"f"', "fx: expected a finite number, got nothing"),
        (
            write_icl_nuim,
            "associations.txt",
            "1 depth/1.png ",
            "depth/1.png ",
            "associations.txt:1: expected 'number depth",
        ),
        (write_icl_nuim, "livingRoom2.gt.freiburg", "1 ", "1 5 ", "freiburg:1: expected 8 numbers, got 9"),
    ],
)
def test_mistakes_are_named(tmp_path, write, file, old, new, match):
    write(tmp_path, POSES[:2], SMALL)
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    with pytest.raises(RecordingError, match=match):
        open_recording(tmp_path)
