"""Every reader against folders of a known room: names, depths, and poses that put the clouds onto each other."""

import json
import shutil

import cv2
import numpy as np
import open3d as o3d
import pytest
from depth_scene import (
    camera_pose,
    render,
    write_apc,
    write_images,
    write_pose_file,
    write_redwood,
    write_seven_scenes,
    write_tum,
)
from folder_layouts import (
    write_bop,
    write_folder,
    write_icl_nuim,
    write_nerfstudio,
    write_replica,
    write_scannet,
    write_sens,
)

from adagmm_fusion.clouds.building import dense_cloud
from adagmm_fusion.errors import RecordingError, RigError
from adagmm_fusion.formats import matching
from adagmm_fusion.formats.icl_nuim import INTRINSICS as ICL_INTRINSICS
from adagmm_fusion.formats.options import PRIMESENSE
from adagmm_fusion.formats.tum import INTRINSICS as TUM_INTRINSICS
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration

SMALL = PinholeIntrinsics(160, 120, 140.0, 141.0, 79.0, 60.5)
VGA = PinholeIntrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
POSES = [camera_pose(yaw, (0.05 * i, 0.1 * i, 1.2 + 0.02 * i)) for i, yaw in enumerate((-12.0, 2.0, 14.0))]
# The writer, the intrinsics it renders with, the depth scale, and the frames' names.
FORMATS = {
    "tum": (write_tum, TUM_INTRINSICS["1"], 5000, ["100.000000", "100.333333", "100.666667"]),
    "redwood": (write_redwood, SMALL, 1000, ["00000", "00001", "00002"]),
    "7scenes": (write_seven_scenes, VGA, 1000, ["frame-000000", "frame-000001", "frame-000002"]),
    "posefile": (write_pose_file, SMALL, 1000, ["00000", "00007", "00014"]),
    "scannet": (write_scannet, SMALL, 1000, ["0", "1", "2"]),
    "sens": (write_sens, SMALL, 1000, ["000000", "000001", "000002"]),
    "icl-nuim": (write_icl_nuim, ICL_INTRINSICS, 5000, ["1", "2", "3"]),
    "bop": (write_bop, SMALL, 10000, ["000000", "000001", "000002"]),
    "replica": (write_replica, SMALL, 6553.5, ["000000", "000001", "000002"]),
    "nerfstudio": (write_nerfstudio, SMALL, 1000, ["frame_00000", "frame_00001", "frame_00002"]),
    "folder": (write_folder, SMALL, 1000, ["0000", "0001", "0002"]),
    "apc": (write_apc, SMALL, 10000, ["frame-000000", "frame-000001", "frame-000002"]),
}


@pytest.fixture(scope="module", params=FORMATS)
def known(request, tmp_path_factory):
    """(format, folder, intrinsics, depth scale, names) of a folder in that format."""
    write, intrinsics, depth_scale, names = FORMATS[request.param]
    folder = tmp_path_factory.mktemp(request.param)
    write(folder, POSES, intrinsics)
    return request.param, folder, intrinsics, depth_scale, names


def test_format_is_recognised_and_frames_are_read_back(known):
    format, folder, intrinsics, depth_scale, names = known
    recording = open_recording(folder)
    frames = recording.frames()
    assert recording.format == format and recording.path == folder
    assert [frames.name(i) for i in range(len(frames))] == names
    for i, pose in enumerate(POSES):
        color, depth = render(intrinsics, pose)
        frame = frames.frame(i)
        assert frame.intrinsics == intrinsics and frame.depth_scale == depth_scale
        assert np.array_equal(frame.color, color)
        metres = frame.depth_m()
        assert np.isnan(metres[:8, :8]).all()
        metres[:8, :8] = depth[:8, :8]
        np.testing.assert_allclose(metres, depth, rtol=1e-6, atol=0.51 / depth_scale)
        np.testing.assert_allclose(frames.pose(i), pose, rtol=0, atol=5e-5 if format == "tum" else 1e-6)


def test_ground_truth_lays_the_clouds_onto_each_other_and_its_inverse_does_not(known):
    _, folder, *_ = known
    recording = open_recording(folder)
    assert len(recording) == 2
    for pair in recording:
        source, target = dense_cloud(pair.source).voxel_down_sample(0.03), dense_cloud(pair.target)
        medians = []
        for T in (pair.T_target_source, np.linalg.inv(pair.T_target_source)):
            moved = o3d.geometry.PointCloud(source).transform(T)
            medians.append(np.median(moved.compute_point_cloud_distance(target)))
        # Pixels are up to 2 cm apart on these walls; a wrong convention is decimetres off.
        assert medians[0] < 0.012 and medians[1] > 0.04


def test_steps_and_names_of_pairs(known):
    _, folder, _, _, names = known
    pair = open_recording(folder, step=2)[0]
    assert (pair.source.name, pair.target.name) == (names[2], names[0])
    assert pair.name == f"{names[2]}_to_{names[0]}" and pair.index == 0
    with pytest.raises(RecordingError, match="no pair"):
        open_recording(folder, step=3)


def test_a_rig_replaces_intrinsics_and_scale(known):
    _, folder, intrinsics, *_ = known
    other = PinholeIntrinsics(intrinsics.width, intrinsics.height, 333.0, 334.0, 80.0, 60.0)
    rig = Rig("mine", {"anything": SensorCalibration("anything", other, 2000.0, None)})
    frame = open_recording(folder, rig=rig)[0].source
    assert frame.intrinsics == other and frame.depth_scale == 2000.0
    two = {name: SensorCalibration(name, other, 2000.0, None) for name in ("a", "b")}
    with pytest.raises(RigError, match="no sensor"):
        open_recording(folder, rig=Rig("two", two))


def test_hidden_files_beside_the_files_say_nothing(known, tmp_path):
    """As macOS leaves them on other systems' disks."""
    format, folder, *_, names = known
    copy = tmp_path / folder.name
    shutil.copytree(folder, copy)
    for path in [path for path in copy.rglob("*") if path.is_file()]:
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\x16\7")
    recording, plain = open_recording(copy), open_recording(folder)
    assert recording.format == format and [entry.name for entry in recording.entries] == names
    assert recording.notes == plain.notes
    for entry, other in zip(recording.entries, plain.entries, strict=True):
        assert np.array_equal(entry.load().color, other.load().color)
        assert np.array_equal(entry.T_world_camera, other.T_world_camera)


@pytest.mark.parametrize("suffix", ["r3d", "mkv", "sens"])
def test_a_hidden_file_alone_is_no_recording(tmp_path, suffix):
    (tmp_path / f"._scan.{suffix}").write_bytes(b"\0\5\x16\7")
    assert matching(tmp_path) == []


def edited(path, old, new, count=1):
    text = path.read_text()
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new, count))


def refused(folder, match, **options):
    with pytest.raises(RecordingError, match=match) as caught:
        open_recording(folder, **options)
    message = str(caught.value)
    assert message.startswith(str(folder)) and "\n" not in message


@pytest.fixture
def tum(tmp_path):
    folder = tmp_path / "rgbd_dataset_freiburg1_room"
    write_tum(folder, POSES[:2], PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0))
    return folder


def test_tum_pairs_name_depth_stamps(tum):
    (tum / "pairs.txt").write_text("# source target\n100.000000 100.333333\n")
    recording = open_recording(tum)
    assert recording.pair_name(0) == "100.000000_to_100.333333"
    (tum / "pairs.txt").write_text("100.000000 100.5\n")
    refused(tum, r"pairs\.txt:1: no frame has its depth at 100\.500000; the nearest is 100\.333333")


def test_tum_pose_is_interpolated_only_where_samples_are_close(tum):
    edited(tum / "groundtruth.txt", "99.970000", "99.800000")
    frames = open_recording(tum).frames()
    assert frames.pose(0) is None and frames.pose(1) is not None
    assert open_recording(tum).frames().timestamp(0) == 100.0
    (tum / "groundtruth.txt").unlink()
    assert open_recording(tum).frames().pose(1) is None


def test_tum_pose_at_a_sample_is_the_sample(tum):
    edited(tum / "groundtruth.txt", "99.970000", "100.000000")
    pose = open_recording(tum).frames().pose(0)
    np.testing.assert_allclose(pose[:3, 3], POSES[0][:3, 3] - (0.01, 0.0, 0.02), rtol=0, atol=1e-8)


def test_tum_associations_file_in_either_order(tum):
    first = "99.996000 rgb/99.996000.png 100.000000 depth/100.000000.png\n"
    second = "100.333333 depth/100.333333.png 100.329333 rgb/100.329333.png\n"
    (tum / "associations.txt").write_text(second + first)
    rig = Rig("small", {"k": SensorCalibration("k", PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0), 5000, None)})
    pair = open_recording(tum, rig=rig)[0]
    assert (pair.target.name, pair.source.name) == ("100.000000", "100.333333")
    assert pair.target.depth.dtype == np.uint16


def test_tum_association_takes_the_nearest_and_each_image_once(tum):
    # A second colour image nearer to the first depth image takes it; the other one is then left without a partner.
    write_images(tum / "rgb/100.001.png", tum / "spare.png", PinholeIntrinsics(32, 24, 30, 30, 16, 12), POSES[1], 5000)
    with open(tum / "rgb.txt", "a") as file:
        file.write("100.001 rgb/100.001.png\n")
    entries = open_recording(tum).entries
    assert len(entries) == 2
    rig = Rig("small", {"k": SensorCalibration("k", PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0), 5000, None)})
    expected, _ = render(PinholeIntrinsics(32, 24, 30, 30, 16, 12), POSES[1])
    assert np.array_equal(open_recording(tum, rig=rig).frames().frame(0).color, expected)


def test_tum_trimmed_copies_are_read(tum):
    for path in (tum / "rgb/99.996000.png", tum / "depth/100.000000.png"):
        path.unlink()
    refused(tum, "no pair of frames to register, there is 1 frame")
    for path in (tum / "rgb/100.329333.png", tum / "depth/100.333333.png"):
        path.unlink()
    refused(tum, "none of the 2 associated colour and depth images is there")


@pytest.mark.parametrize(
    "file, old, new, match",
    [
        ("depth.txt", "100.000000 depth/100.000000.png", "100.000000", r"depth\.txt:3: expected 'timestamp path'"),
        ("depth.txt", "100.000000 depth", "soon depth", r"depth\.txt:3: expected 1 numbers, got 'soon'"),
        ("depth.txt", "depth/100.000000.png", "../outside.png", r"depth\.txt:3: .* leads out of the recording"),
        ("rgb.txt", "rgb/99.996000.png", "rgb/\0.png", r"rgb\.txt:3: .* is not a path that can be used"),
        ("rgb.txt", "rgb/99.996000.png", "r" * 5000, r"rgb\.txt:3: .* is not a path that can be used"),
        ("rgb.txt", "rgb/99.996000.png", "/etc/hostname", r"rgb\.txt:3: .* leads out of the recording"),
        ("groundtruth.txt", "99.970000 ", "99.970000 1 ", r"groundtruth\.txt:2: expected 8 numbers, got 9"),
        ("groundtruth.txt", "99.970000 ", "nan ", r"groundtruth\.txt:2: expected finite numbers"),
    ],
)
def test_tum_mistakes_are_named_with_file_and_line(tum, file, old, new, match):
    edited(tum / file, old, new)
    refused(tum, match)


def test_tum_quaternion_must_be_a_unit_one(tum):
    (tum / "groundtruth.txt").write_text("1 0 0 0 0 0 0 2\n2 0 0 0 0 0 0 1\n")
    refused(tum, r"groundtruth\.txt:1: expected a unit quaternion")


@pytest.mark.parametrize(
    ("format", "place"), [("tum", "K.txt"), ("7scenes", "K.txt"), ("7scenes", "../camera-intrinsics.txt")]
)
def test_intrinsics_in_a_folder_of_a_known_camera_count(tmp_path, format, place):
    """They were passed over, and the data set's numbers taken."""
    folder = tmp_path / "freiburg1"
    FORMATS[format][0](folder, POSES[:2], SMALL)
    np.savetxt(folder / place, SMALL.matrix())
    recording = open_recording(folder)
    assert recording.format == format and recording[0].source.intrinsics == SMALL
    assert recording.notes == (f"the intrinsics are those of {place.removeprefix('../')}",)
    np.savetxt(folder / "K.txt", SMALL.matrix())
    np.savetxt(folder / "intrinsics.txt", SMALL.matrix() * [[1.1], [1.1], [1]])
    refused(folder, r"K\.txt and intrinsics\.txt: two different calibrations for .* images, fx .*; keep the true one")


def test_files_that_say_the_same_of_a_known_camera_count_once(tmp_path):
    """Two files of one camera were compared to the last bit, and the other size of one refused."""
    folder = tmp_path / "freiburg1"
    write_tum(folder, POSES[:2], SMALL)
    np.savetxt(folder / "K.txt", SMALL.matrix())
    np.savetxt(folder / "intrinsics.txt", SMALL.matrix() * [[1 + 1e-4], [1 + 1e-4], [1]])
    whole = {"width": SMALL.width * 2, "height": SMALL.height * 2} | {
        name: 2 * getattr(SMALL, name) for name in ("fx", "fy")
    }
    (folder / "camera_info.json").write_text(json.dumps(whole | {"cx": 2 * SMALL.cx + 0.5, "cy": 2 * SMALL.cy + 0.5}))
    (folder / "camera.txt").write_text("a camera of mine\n")
    recording = open_recording(folder)
    assert recording[0].source.intrinsics.fx == pytest.approx(SMALL.fx, rel=1e-3)
    assert any("not understood as a calibration and not used: camera.txt" in note for note in recording.notes)


def test_a_depth_camera_beside_depth_that_is_registered_is_said_not_used(tmp_path):
    folder = tmp_path / "freiburg1"
    write_tum(folder, POSES[:2], SMALL)
    np.savetxt(folder / "color_intrinsics.txt", SMALL.matrix())
    np.savetxt(folder / "depth_intrinsics.txt", VGA.matrix())
    np.savetxt(folder / "depth_to_color.txt", np.eye(4))
    recording = open_recording(folder)
    assert recording[0].source.intrinsics == SMALL
    assert any("depth_intrinsics.txt is not used" in note for note in recording.notes)


def test_tum_comment_that_names_the_columns_counts(tum):
    expected = open_recording(tum).entries[1].T_world_camera
    lines = (tum / "groundtruth.txt").read_text().splitlines()[1:]
    moved = [" ".join((*words[:4], words[7], *words[4:7])) for words in map(str.split, lines)]
    (tum / "groundtruth.txt").write_text("\n".join(["# timestamp tx ty tz qw qx qy qz", *moved]) + "\n")
    np.testing.assert_allclose(open_recording(tum).entries[1].T_world_camera, expected, rtol=0, atol=1e-9)


def test_tum_poses_of_nan_are_none(tum):
    lines = (tum / "groundtruth.txt").read_text().splitlines()
    stamp = lines[1].split()[0]
    (tum / "groundtruth.txt").write_text("\n".join([lines[0], f"{stamp} nan nan nan nan nan nan nan", *lines[2:]]))
    poses = [entry.T_world_camera for entry in open_recording(tum).entries]
    assert poses[0] is None and poses[-1] is not None


def test_tum_trajectory_by_another_clock_is_said(tum):
    """It was passed over, and no ground truth known."""
    assert open_recording(tum).notes == ()
    lines = (tum / "groundtruth.txt").read_text().splitlines()[1:]
    rows = [(float(line.split()[0]), line.split()[1:]) for line in lines]
    (tum / "groundtruth.txt").write_text("".join(" ".join([f"{t - 99:.6f}", *row]) + "\n" for t, row in rows))
    recording = open_recording(tum)
    stamps = [entry.timestamp for entry in recording.entries]
    assert recording.notes == (
        f"groundtruth.txt: it reaches from {rows[0][0] - 99:.3f} to {rows[-1][0] - 99:.3f} s and the frames from "
        f"{stamps[0]:.3f} to {stamps[-1]:.3f} s, none within it; do their clocks differ? no pose is known, "
        "give both the same times",
    )
    assert all(entry.T_world_camera is None for entry in recording.entries)


@pytest.mark.parametrize("name", ["associations.txt", "associate.txt"])
def test_tum_with_associations_alone(tum, name):
    """It was read as any folder, with millimetres."""
    known = open_recording(tum)
    pairs = [((tum / file).read_text().splitlines()) for file in ("rgb.txt", "depth.txt")]
    rows = [[line.replace("/", "\\") for line in lines if not line.startswith("#")] for lines in pairs]
    (tum / name).write_text("\n".join(" ".join(both) for both in zip(*rows, strict=True)) + "\n")
    for file in ("rgb.txt", "depth.txt"):
        (tum / file).unlink()
    np.savetxt(tum / "K.txt", SMALL.matrix())
    recording = open_recording(tum)
    assert recording.format == "tum" and len(recording.entries) == len(known.entries)
    assert recording.entries[1].load().depth_scale == 5000.0
    np.testing.assert_allclose(recording.entries[1].T_world_camera, known.entries[1].T_world_camera, atol=1e-9)


def test_tum_lists_most_of_whose_images_are_absent_are_said(tum):
    """It was passed over how little of a recording is there."""
    for kind in ("rgb", "depth"):
        rows = "".join(f"{200 + i}.000000 {kind}/{200 + i}.png\n" for i in range(len(open_recording(tum).entries) + 1))
        with (tum / f"{kind}.txt").open("a") as file:
            file.write(rows)
        count = rows.count("\n")
    said = "of its {} images are not there, such as {}/200.png; frames that lack both are left out: is the copy whole?"
    expected = tuple(f"{kind}.txt: {count} {said.format(2 * count - 1, kind)}" for kind in ("rgb", "depth"))
    assert open_recording(tum).notes == expected
    for kind in ("rgb", "depth"):  # just half of them
        lines = (tum / f"{kind}.txt").read_text().splitlines()
        (tum / f"{kind}.txt").write_text("\n".join(lines[:-1]) + "\n")
    assert open_recording(tum).notes == ()


def test_tum_without_any_of_its_images_names_one(tum):
    shutil.rmtree(tum / "rgb")
    shutil.rmtree(tum / "depth")
    refused(tum, r"none of the \d+ associated colour and depth images is there, such as rgb/")


def test_tum_of_an_unknown_sensor_needs_a_rig(tmp_path):
    folder = tmp_path / "desk"
    write_tum(folder, POSES[:2], SMALL)
    edited(folder / "depth.txt", "freiburg1", "my camera")
    refused(folder, "intrinsics of kinect are not known here; give a rig")


@pytest.mark.parametrize("name, number", [("fr2_desk", "2"), ("rgbd_dataset_freiburg3_office", "3")])
def test_tum_intrinsics_by_the_folders_name(tum, name, number):
    recording = open_recording(tum.rename(tum.parent / name))
    assert recording.entries[0].load.args[4] == TUM_INTRINSICS[number]


@pytest.fixture
def redwood(tmp_path):
    write_redwood(tmp_path, POSES, PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0))
    return tmp_path


@pytest.mark.parametrize(
    "old, new, match",
    [
        ("1 1 2\n", "3 1 2\n", r"trajectory\.log:6: expected a frame index from 0 to 2, got 3"),
        ("1 1 2\n", "0 1 2\n", r"trajectory\.log:6: frame 0 has a pose already"),
        ("1 1 2\n", "1 1\n", r"trajectory\.log:6: expected 3 numbers"),
        ("1 1 2\n", "", r"trajectory\.log: expected five lines a frame, got 14"),
        ("0.000000000 0.000000000 0.000000000 1.000000000", "0 0 1 1", r"trajectory\.log:1: pose: expected 0 0 0 1"),
    ],
)
def test_redwood_trajectory_mistakes(redwood, old, new, match):
    edited(redwood / "trajectory.log", old, new)
    refused(redwood, match)


def test_redwood_frames_without_a_pose_are_counted(redwood):
    lines = (redwood / "trajectory.log").read_text().splitlines()
    (redwood / "trajectory.log").write_text("\n".join(lines[5:]) + "\n")
    recording = open_recording(redwood)
    assert [entry.T_world_camera is None for entry in recording.entries] == [True, False, False]
    assert recording.notes == (
        "trajectory.log: 1 of 3 frames have no pose in it; pairs with them have no ground truth",
    )


def test_redwood_without_json_is_primesense_and_without_log_has_no_truth(tmp_path):
    write_redwood(tmp_path, POSES[:2], PRIMESENSE)
    (tmp_path / "camera_intrinsic.json").unlink()
    recording = open_recording(tmp_path)
    assert recording[0].source.intrinsics == PRIMESENSE
    (note,) = recording.notes
    assert note == "the intrinsics are taken for PrimeSense's 525 525 319.5 239.5, no camera_intrinsic.json says"
    (tmp_path / "trajectory.log").rename(tmp_path / "poses.log")
    assert open_recording(tmp_path).frames().pose(0) is not None
    shutil.copyfile(tmp_path / "poses.log", tmp_path / "odometry.log")
    refused(tmp_path, "several trajectories")
    (tmp_path / "poses.log").unlink()
    (tmp_path / "odometry.log").unlink()
    hint = "--format redwood takes PrimeSense's 525 525 319.5 239.5, for a Kinect v1 or an Xtion"
    refused(tmp_path, f"not a recording of a known format, but nearly: .* or give a rig file; {hint}$")
    recording = open_recording(tmp_path, format="redwood")
    assert recording.frames().pose(0) is None and recording[0].source.intrinsics == PRIMESENSE


def test_redwood_images_of_another_size_are_not_taken_for_primesense(redwood):
    (redwood / "camera_intrinsic.json").unlink()
    refused(redwood, "expected camera_intrinsic.json, as images of 32x24 pixels are not PrimeSense's of 640x480")


def redwood_camera(folder, **more):
    K = [30.0, 0, 0, 0, 30.0, 0, 16.0, 12.0, 1]
    (folder / "camera_intrinsic.json").write_text(json.dumps({"width": 32, "height": 24, "intrinsic_matrix": K} | more))


def test_redwood_depth_scale_and_distortion_of_the_camera_file_count(redwood):
    redwood_camera(redwood, depth_scale=250, distortion=[0.1, -0.2, 0, 0, 0])
    recording = open_recording(redwood)
    frame = recording[0].source
    assert recording.format == "redwood"
    assert (frame.depth_scale, frame.intrinsics.distortion[:2]) == (250.0, (0.1, -0.2))


def test_redwood_cx_and_cy_that_look_exchanged_are_said(redwood):
    redwood_camera(redwood, intrinsic_matrix=[30.0, 0, 0, 0, 30.0, 0, 12.0, 16.0, 1])
    recording = open_recording(redwood)
    assert recording.format == "redwood"
    assert recording.notes[0].startswith("camera_intrinsic.json: cx 12 cy 16 look exchanged, for images of 32x24")


@pytest.mark.parametrize("name", ["K.txt", "calibration.json"])
def test_redwood_beside_another_camera_file_is_read_with_that(redwood, name):
    """It was passed over, and PrimeSense's numbers taken."""
    (redwood / "camera_intrinsic.json").unlink()
    K = [[40.0, 0, 16.0], [0, 41.0, 12.0], [0, 0, 1]]
    (redwood / name).write_text(
        "\n".join(" ".join(map(str, row)) for row in K) if name == "K.txt" else json.dumps({"K": K})
    )
    recording = open_recording(redwood)
    assert recording.format == "folder"
    assert recording[0].source.intrinsics.fy == 41.0


NOT_OPEN3D = [
    {"width": 32, "height": 24, "fx": 30, "fy": 30, "cx": 16, "cy": 12},
    {"width": 32, "height": 24, "intrinsic_matrix": [[30, 0, 16], [0, 30, 12], [0, 0, 1]]},
    {"width": 32, "height": 24, "intrinsic_matrix": [30, 0, 16, 0, 30, 12, 0, 0, 1]},
]


@pytest.mark.parametrize("values", NOT_OPEN3D)
def test_redwood_camera_of_another_form_is_read_as_a_folder(redwood, values):
    (redwood / "camera_intrinsic.json").write_text(json.dumps(values))
    recording = open_recording(redwood)
    assert recording.format == "folder"
    k = recording[0].source.intrinsics
    assert (k.fx, k.cx, k.cy) == (30.0, 16.0, 12.0)
    np.testing.assert_allclose(recording.entries[1].T_world_camera, POSES[1], rtol=0, atol=1e-6)


def renamed(folder, color, depth):
    for kind, names in (("color", color), ("depth", depth)):
        for path, name in zip(sorted((folder / kind).iterdir()), names, strict=True):
            path.rename(folder / kind / f"{name}.png")


def test_redwood_names_that_share_what_is_before_a_dash_lose_no_frame(redwood):
    names = ["120000-033", "120000-066", "120001-000"]
    renamed(redwood, names, names)
    recording = open_recording(redwood)
    assert [entry.name for entry in recording.entries] == names and recording.notes == ()


def test_redwood_names_that_do_not_pair_are_read_as_a_folder(redwood):
    renamed(redwood, *([f"frame-{i:06d}.{kind}" for i in range(3)] for kind in ("color", "depth")))
    assert open_recording(redwood).format == "folder" and len(open_recording(redwood).entries) == 3
    refused(redwood, "expected images of equal names", format="redwood")


def test_redwood_counts_frames_by_their_numbers(redwood):
    """The second pose is that of frame 9 and not of frame 10, which is before it by letters."""
    renamed(redwood, *[["8", "9", "10"]] * 2)
    recording = open_recording(redwood)
    assert [entry.name for entry in recording.entries] == ["8", "9", "10"]
    np.testing.assert_allclose(recording.entries[1].T_world_camera, POSES[1], rtol=0, atol=1e-6)


def test_redwood_log_of_a_program_is_no_trajectory(redwood):
    (redwood / "trajectory.log").unlink()
    (redwood / "capture.log").write_text("2024-01-01 12:00 started\n2024-01-01 12:01 stopped\n")
    recording = open_recording(redwood)
    assert recording.format == "redwood" and recording.frames().pose(0) is None
    assert recording.notes[0].startswith("capture.log: left out, it is no trajectory")
    (redwood / "camera_intrinsic.json").unlink()
    refused(redwood, "not a recording of a known format, but nearly: .* or give a rig file$")  # not PrimeSense's size


def test_redwood_frames_must_have_partners(redwood):
    next(redwood.glob("depth/00001-*")).unlink()
    refused(redwood, r"no pair of frames .*; left out, without their depth image: 00001$", step=2)


def test_pose_file_line_of_nan_is_no_pose(tmp_path):
    write_pose_file(tmp_path, POSES, SMALL)
    lines = (tmp_path / "poses.txt").read_text().splitlines()
    (tmp_path / "poses.txt").write_text("\n".join([lines[0], "nan " * 16, lines[2]]))
    assert [entry.T_world_camera is None for entry in open_recording(tmp_path).entries] == [False, True, False]


@pytest.mark.parametrize("kind", ["color", "depth"])
def test_redwood_frames_without_a_partner_are_left_out_and_the_others_keep_their_poses(tmp_path, kind):
    write_redwood(tmp_path, POSES, SMALL)
    next(tmp_path.glob(f"{kind}/00001-*")).unlink()
    recording = open_recording(tmp_path)
    assert [entry.name for entry in recording.entries] == ["00000", "00002"]
    missing = {"color": "colour", "depth": "depth"}[kind]
    assert recording.notes == (f"left out, without their {missing} image: 00001",)
    np.testing.assert_allclose(recording.entries[1].T_world_camera, POSES[2], rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["camera_intrinsic.json", "intrinsic.json"])
def test_redwood_intrinsics_may_have_either_name(redwood, name):
    (redwood / "camera_intrinsic.json").rename(redwood / name)
    (redwood / "trajectory.log").unlink()
    assert open_recording(redwood).format == "redwood"
    assert open_recording(redwood)[0].source.intrinsics.width == 32


@pytest.mark.parametrize("units", [1e3, 1e6, 1e9])
@pytest.mark.parametrize("start", [0.0, 1305031233.0])
def test_tum_times_in_other_units(tmp_path, units, start):
    """As a clock that counts from zero, and as one that counts from 1970, gives them."""
    seconds = tmp_path / "seconds" / "freiburg1"
    write_tum(seconds, POSES, PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0))
    expected = open_recording(seconds).entries
    for name in ("rgb.txt", "depth.txt", "groundtruth.txt"):
        rows = [row.split(maxsplit=1) for row in (seconds / name).read_text().splitlines() if not row.startswith("#")]
        moved = [f"{round((float(stamp) - 100.0 + start) * units + units)} {rest}" for stamp, rest in rows]
        (seconds / name).write_text("\n".join(moved) + "\n")
    entries = open_recording(seconds.rename(tmp_path / "freiburg1")).entries
    assert len(entries) == len(POSES)
    for entry, known in zip(entries, expected, strict=True):
        assert entry.timestamp == pytest.approx(known.timestamp - 99.0 + start, rel=0, abs=0.001)
        np.testing.assert_allclose(entry.T_world_camera, known.T_world_camera, rtol=0, atol=1e-3)


def test_seven_scenes_colour_may_be_jpeg(tmp_path):
    write_seven_scenes(tmp_path, POSES[:2], VGA)
    for path in tmp_path.glob("*.color.png"):
        assert cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)))
        path.unlink()
    frame = open_recording(tmp_path)[0].source
    assert np.abs(frame.color.astype(int) - render(VGA, POSES[1])[0]).mean() < 10


@pytest.mark.parametrize(
    "content, match",
    [
        ("{", r"camera_intrinsic\.json: not valid JSON"),
        ('{"width": 32, "height": 24}', r"no intrinsics; camera_intrinsic\.json: not understood"),
        (json.dumps({"width": 32, "height": 24, "intrinsic_matrix": [1, 2, 3]}), r"camera_intrinsic\.json.* got 3"),
        (json.dumps({"width": 0, "height": 24, "intrinsic_matrix": [30, 0, 0, 0, 30, 0, 16, 12, 1]}), "image size"),
    ],
)
def test_redwood_intrinsics_mistakes(redwood, content, match):
    (redwood / "camera_intrinsic.json").write_text(content)
    refused(redwood, match)


@pytest.fixture
def seven_scenes(tmp_path):
    write_seven_scenes(tmp_path, POSES[:2], PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0))
    return tmp_path


def test_seven_scenes_lost_tracking_is_no_truth(seven_scenes):
    (seven_scenes / "frame-000001.pose.txt").write_text("-inf " * 15 + "1\n")
    frames = open_recording(seven_scenes).frames()
    assert frames.pose(0) is not None and frames.pose(1) is None


@pytest.mark.parametrize(
    "content, match", [("1 0 0", "expected 16 numbers, got 3"), ("here " * 16, "expected 16 numbers")]
)
def test_seven_scenes_pose_mistakes(seven_scenes, content, match):
    (seven_scenes / "frame-000001.pose.txt").write_text(content)
    refused(seven_scenes, rf"frame-000001\.pose\.txt: {match}")


def test_seven_scenes_size_is_checked(seven_scenes):
    with pytest.raises(RecordingError, match=r"frame-000001\.depth\.png: .*32x24 and the intrinsics are for 640x480"):
        open_recording(seven_scenes)[0]


@pytest.fixture
def pose_file(tmp_path):
    write_pose_file(tmp_path, POSES, PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0))
    return tmp_path


def test_pose_file_pairs_and_trimmed_copies(pose_file):
    (pose_file / "pairs.txt").write_text("00014.png 00000.png\n")
    assert open_recording(pose_file).pair_name(0) == "00014_to_00000"
    for kind in ("images", "depth"):
        (pose_file / kind / "00007.png").unlink()
    frames = open_recording(pose_file).frames()
    assert len(frames) == 2
    np.testing.assert_allclose(frames.pose(1), POSES[2], rtol=0, atol=1e-12)
    (pose_file / "pairs.txt").write_text("00014.png 00007.png\n")
    refused(pose_file, r"pairs\.txt:1: there is no frame '00007\.png'")


@pytest.mark.parametrize(
    "file, content, match",
    [
        ("K.txt", "30 0 16\n0 30 12\n", r"K\.txt: expected 3 lines of 3 numbers, got 2"),
        ("K.txt", "30 5 16\n0 30 12\n0 0 1\n", r"K\.txt: expected a camera matrix"),
        ("K.txt", "-30 0 16\n0 30 12\n0 0 1\n", r"K\.txt: intrinsics\.fx"),
        ("poses.txt", "1 0 0 0\n", r"poses\.txt:1: expected 16 numbers, got 4"),
        ("poses.txt", " ".join("1" * 16) + "\n", r"poses\.txt:1: pose: "),
        (
            "all_frame_names.txt",
            "00000.png\n",
            r"poses\.txt: expected 1 poses, as all_frame_names\.txt has names, got 3",
        ),
        ("all_frame_names.txt", "../../a.png\nb.png\nc.png\n", r"all_frame_names\.txt:1: .* leads out of the"),
        ("all_frame_names.txt", "a.png\nb.png\nc.png\n", "none of the 3 images"),
        ("all_frame_names.txt", "a b\n", r"all_frame_names\.txt:1: expected one image name"),
    ],
)
def test_pose_file_mistakes(pose_file, file, content, match):
    (pose_file / file).write_text(content)
    refused(pose_file, match)


@pytest.fixture
def apc(tmp_path):
    write_apc(tmp_path, POSES[:2], PinholeIntrinsics(32, 24, 30.0, 30.0, 16.0, 12.0))
    return tmp_path


@pytest.mark.parametrize(
    "old, new, match",
    [
        (
            "# Color camera intrinsic",
            "# Colour camera intrinsic",
            "the heading '# Color camera intrinsic matrix' is missing",
        ),
        (" 0.00000000e+00\t 3.00000000e+01", " 3.00000000e+01", r"cam\.info\.txt:6: expected 3 numbers, got 2"),
        (
            "\n# Camera-to-world extrinsic matrix (camera pose) for frame-000001",
            "",
            r"cam\.info\.txt:10: expected 4 rows",
        ),
        (" 0.00000000e+00\t 0.00000000e+00\t 0.00000000e+00\t 1.0", " 1\t 0\t 0\t 1.0", r"cam\.info\.txt:10: pose: "),
    ],
)
def test_apc_mistakes(apc, old, new, match):
    edited(apc / "cam.info.txt", old, new)
    refused(apc, match)


def test_apc_frame_without_a_pose_has_no_truth(apc):
    edited(apc / "cam.info.txt", "for frame-000001", "for frame-000007")
    frames = open_recording(apc).frames()
    assert frames.pose(0) is not None and frames.pose(1) is None
