"""The generic reader: folders of colour, depth and a calibration as people lay them out, each with one oddity."""

import json
from functools import partial

import cv2
import numpy as np
import pytest
from depth_scene import camera_pose, render, write_tum
from folder_layouts import OPENGL, depth_of, write_color, write_depth, write_json
from scipy.spatial.transform import Rotation

from adagmm_fusion.clouds.building import dense_cloud
from adagmm_fusion.commands.run_many import recordings_in
from adagmm_fusion.errors import RecordingError
from adagmm_fusion.files.atomic_file import write_text
from adagmm_fusion.formats.pose_lists import EXPECTED, find_poses
from adagmm_fusion.frames.rgbd import PinholeIntrinsics
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.rig import Rig, SensorCalibration

SMALL = PinholeIntrinsics(160, 120, 140.0, 141.0, 79.0, 60.5)
POSES = [camera_pose(yaw, (0.05 * i, 0.1 * i, 1.2 + 0.02 * i)) for i, yaw in enumerate((-12.0, 2.0, 14.0))]
MATRIX = "\n".join(" ".join(map(str, row)) for row in SMALL.matrix())


def layout(folder, color="color/{i:06d}.png", depth="depth/{i:06d}.png", K=("K.txt", MATRIX), poses=POSES):
    for i, pose in enumerate(poses):
        write_color(folder / color.format(i=i, n=i + 1, t=1e9 + i / 30), SMALL, pose)
        write_depth(folder / depth.format(i=i, n=i + 1, t=1e9 + i / 30 + 0.004), SMALL, pose, 1000)
    if K is not None:
        write_text(folder / K[0], K[1])
    return folder


def is_the_room(recording, intrinsics=SMALL, poses=POSES):
    assert recording.format == "folder" and len(recording.entries) == len(poses)
    for entry, pose in zip(recording.entries, poses, strict=True):
        color, depth = render(intrinsics, pose)
        frame = entry.load()
        assert frame.intrinsics == intrinsics
        assert np.array_equal(frame.color, color)
        metres = frame.depth_m()
        metres[:8, :8] = depth[:8, :8]
        np.testing.assert_allclose(metres, depth, rtol=1e-6, atol=6e-4)


NAMES = [
    ("color/{i:06d}.png", "depth/{i:06d}.png"),
    ("rgb/rgb_{i}.png", "depth/depth_{i:05d}.png"),
    ("images/{t:.6f}.png", "depth_aligned/{t:.6f}.png"),
    ("rgb_raw/{i}.png", "depth_raw/{i}.png"),
    ("frame-{i:06d}.color.png", "frame-{i:06d}.depth.png"),
    ("{i:03d}_color.png", "{i:03d}_depth.png"),
    ("scan_{i}.png", "scan_{i}_depth.png"),
]


@pytest.mark.parametrize(("color", "depth"), NAMES)
def test_images_are_found_and_paired_whatever_their_names(tmp_path, color, depth):
    recording = open_recording(layout(tmp_path, color, depth))
    is_the_room(recording)
    assert recording.notes == ("depth is taken for millimetres, no file says so",)


def test_numbers_are_sorted_as_numbers_and_what_has_no_partner_is_left_out(tmp_path):
    layout(tmp_path, "rgb/{i}.png", "depth/{i}.png", poses=POSES * 4)
    (tmp_path / "rgb" / "7.png").unlink()
    recording = open_recording(tmp_path)
    assert [entry.name for entry in recording.entries] == ["0", "1", "2", "3", "4", "5", "6", "8", "9", "10", "11"]
    assert recording.notes[0] == "left out, without their colour image: depth/7.png"


@pytest.mark.parametrize(
    ("color", "depth", "lag"),
    [("rgb/{i}.png", "depth/{j}.png", "1 higher"), ("rgb/{t:.2f}.png", "depth/{u:.2f}.png", "0.5 lower")],
)
def test_lists_that_are_shifted_against_each_other_are_said_to_be(tmp_path, color, depth, lag):
    for i in range(8):
        names = {"i": i, "j": i + 1, "t": 1000.0 + 0.1 * i, "u": 1000.0 + 0.1 * i - 0.5}
        for form, write in ((color, write_color), (depth, partial(write_depth, depth_scale=1000.0))):
            path = tmp_path / form.format(**names)
            path.parent.mkdir(exist_ok=True)
            write(path, SMALL, POSES[0])
    write_text(tmp_path / "K.txt", MATRIX)
    notes = open_recording(tmp_path).notes
    assert any(f"in order the depth's numbers all are {lag}: images of equal numbers" in note for note in notes)


def test_archives_of_arrays_are_said_not_to_be_read(tmp_path):
    layout(tmp_path, "rgb/{i}.png", "depth/{i}.png")
    for path in (tmp_path / "depth").iterdir():
        np.savez(path.with_suffix(".npz"), depth=np.ones((3, 4)))
        path.unlink()
    with pytest.raises(RecordingError, match=r"\.npz archives are not read: save each array as \.npy"):
        open_recording(tmp_path)


JSON = {"width": 160, "height": 120}
CAMERAS = {
    "3x3": ("intrinsics.txt", MATRIX),
    "3x3 with commas and brackets": ("camera_matrix.csv", f"[{MATRIX.replace(' ', ', ')}]"),
    "4x4": ("intrinsic/intrinsic_color.txt", "140 0 79 0\n0 141 60.5 0\n0 0 1 0\n0 0 0 1\n"),
    "four numbers": ("K.txt", "140 141 79 60.5"),
    "lines of names": ("camera.txt", "fx = 140\nfy = 141\ncx: 79\ncy: 60.5\n"),
    "names on a line": ("K.txt", "fx 140 fy: 141, cx=79 cy = 60.5\n"),
    "nested json": ("calib.json", json.dumps({"rgb": {"fx": 140, "fy": 141, "ppx": 79, "ppy": 60.5}, **JSON})),
    "rows": ("k.json", json.dumps({"K": SMALL.matrix().tolist()})),
    "columns": ("camera_intrinsics.json", json.dumps({"intrinsic_matrix": SMALL.matrix().T.ravel().tolist(), **JSON})),
    "ros": (
        "camera_info.yaml",
        f"image_width: 160\nimage_height: 120\nK: {SMALL.matrix().ravel().tolist()}\nD: [0.0]\n",
    ),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_intrinsics_in_whatever_file(tmp_path, name):
    is_the_room(open_recording(layout(tmp_path, K=CAMERAS[name])))


def test_distortion_and_depth_scale_of_a_json_file_count(tmp_path):
    values = {"fl_x": 140, "fl_y": 141, "cx": 79, "cy": 60.5, "w": 160, "h": 120, "k1": 0.1, "p1": 0.01}
    write_json(layout(tmp_path, K=None) / "camera.json", values | {"depth_scale": 0.001})
    recording = open_recording(tmp_path)
    assert recording.entries[0].load().intrinsics.distortion == (0.1, 0.0, 0.01, 0.0)
    assert recording.entries[0].load().depth_scale == 1000.0 and recording.notes == ()
    write_json(tmp_path / "camera.json", values | {"lens_distortion": [0.1]})
    with pytest.raises(RecordingError, match="lensdistortion: this lens distortion is not understood"):
        open_recording(tmp_path)


def test_depth_as_metres(tmp_path):
    layout(tmp_path)
    for path in sorted((tmp_path / "depth").iterdir()):
        np.save(path.with_suffix(".npy"), cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32) / 1000)
        path.unlink()
    recording = open_recording(tmp_path)
    is_the_room(recording)
    assert recording.notes == ("depth is taken for metres, no file says so",)


def pose_rows(poses, form):
    return "\n".join(form(i, np.asarray(T)) for i, T in enumerate(poses)) + "\n"


def quaternion(T):
    from scipy.spatial.transform import Rotation

    return " ".join(map(str, (*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_quat())))


def numbers(T):
    return " ".join(map(str, T.ravel()))


POSE_FILES = {
    "16 a line": ("traj.txt", lambda i, T: numbers(T)),
    "kitti": ("poses.txt", lambda i, T: numbers(T[:3])),
    "numbered": ("poses_c2w.txt", lambda i, T: f"{i} {numbers(T)}"),
    "quaternions": ("groundtruth.txt", lambda i, T: f"{i} {quaternion(T)}"),
    "log": ("odometry.log", lambda i, T: f"{i} {i} {i + 1}\n" + "\n".join(map(numbers, T))),
    "csv with headings": ("odometry.csv", lambda i, T: ("n, p\n" if i == 0 else "") + f"{i}, {numbers(T)}"),
}
MEANT = {
    "camera to world": lambda T: T,
    "the inverse of camera to world": np.linalg.inv,
    "of a camera with y up and z backward of camera to world": lambda T: T @ OPENGL,
}


# Where the name says which way round, only that is there.
POSE_CASES = [(name, meant) for name in POSE_FILES for meant in MEANT if "c2w" not in POSE_FILES[name][0]]


@pytest.mark.parametrize(("name", "meant"), [*POSE_CASES, ("numbered", "camera to world")])
def test_poses_in_whatever_file_and_whichever_way_round(tmp_path, name, meant):
    file, form = POSE_FILES[name]
    layout(tmp_path)
    (tmp_path / file).write_text(pose_rows([MEANT[meant](T) for T in POSES], form))
    recording = open_recording(tmp_path, format="folder")
    assert f"poses of {file} are read as {meant}: " in recording.notes[-1]
    for entry, pose in zip(recording.entries, POSES, strict=True):
        np.testing.assert_allclose(entry.T_world_camera, pose, rtol=0, atol=1e-9)


def posed(folder, poses=POSES):
    """The folder's poses are those of the room."""
    recording = open_recording(folder)
    for entry, pose in zip(recording.entries, poses, strict=True):
        assert (entry.T_world_camera is None) == (pose is None)
        if pose is not None:
            np.testing.assert_allclose(entry.T_world_camera, pose, rtol=0, atol=1e-6)
    return recording


def row(order, key, T):
    values = dict(zip(("tx", "ty", "tz", "qx", "qy", "qz", "qw"), quaternion(T).split(), strict=True)) | {"frame": key}
    return [values[name] for name in order]


ORDERS = [
    "frame tx ty tz qw qx qy qz",
    "frame qw qx qy qz tx ty tz",
    "tx ty tz qx qy qz qw frame",
    "qw qx qy qz tx ty tz",
]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(("before", "between", "file"), [("# ", " ", "traj.txt"), ("", ",", "poses.csv")])
def test_headings_that_name_the_columns_of_poses_count(tmp_path, order, before, between, file):
    order = order.split()
    rows = [between.join(row(order, str(i), T)) for i, T in enumerate(POSES)]
    write_text(layout(tmp_path) / file, "\n".join([before + between.join(order), *rows]) + "\n")
    posed(tmp_path)


@pytest.mark.parametrize(
    "heading", ["#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"]
)
def test_headings_of_euroc_count(tmp_path, heading):
    order = ORDERS[0].split()
    rows = [",".join(row(order, str(i), T)) for i, T in enumerate(POSES)]
    write_text(layout(tmp_path) / "groundtruth.csv", "\n".join([heading, *rows]) + "\n")
    posed(tmp_path)


@pytest.mark.parametrize("heading", ["# frame tx ty tz qx qy qz", "# frame px py pz w x y z"])
def test_headings_that_are_not_understood_are_refused(tmp_path, heading):
    rows = [f"{i} {quaternion(T)}" for i, T in enumerate(POSES)]
    write_text(layout(tmp_path) / "poses.txt", "\n".join([heading, *rows]) + "\n")
    with pytest.raises(RecordingError, match=r"poses\.txt:1: expected headings such as timestamp tx"):
        open_recording(tmp_path)


BLOCKS = {
    "4x4": lambda i, T: "\n".join(map(numbers, T)) + "\n",
    "3x4": lambda i, T: "\n".join(map(numbers, T[:3])) + "\n",
    "4x4 below a number": lambda i, T: f"{i}\n" + "\n".join(map(numbers, T)),
}


@pytest.mark.parametrize("form", BLOCKS)
def test_poses_one_below_the_other(tmp_path, form):
    write_text(layout(tmp_path) / "poses.txt", pose_rows(POSES, BLOCKS[form]))
    posed(tmp_path)


@pytest.mark.parametrize("shape", [(-1, 4, 4), (-1, 3, 4), (-1, 16)])
def test_poses_in_an_array(tmp_path, shape):
    poses = np.array(POSES)[:, :3] if shape[1] == 3 else np.array(POSES)
    np.save(layout(tmp_path) / "poses.npy", poses.reshape(shape))
    posed(tmp_path)


def test_a_file_without_a_number_beside_a_pose_file_a_frame_is_no_matter(tmp_path):
    layout(tmp_path)
    for i, pose in enumerate(POSES):
        write_text(tmp_path / f"poses/{i:06d}.txt", numbers(pose))
    write_text(tmp_path / "poses/info.txt", "recorded with a phone\n")
    posed(tmp_path)


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("poses.json", "{}"),
        ("poses.txt", f"{numbers(POSES[0])}\n{numbers(POSES[1])}\n1 0 0\n"),
        ("trajectory.txt", "1 0 0 0\n" * 6),
    ],
)
def test_a_file_of_poses_that_is_not_understood_is_noted(tmp_path, file, text):
    write_text(layout(tmp_path) / file, text)
    notes = []
    assert find_poses(tmp_path, sorted((tmp_path / "depth").iterdir()), notes) is None
    assert notes == [f"{file}: not understood, left out; expected {EXPECTED}"]


def test_a_pose_of_nan_is_none(tmp_path):
    lost = np.full((4, 4), np.nan)
    write_text(layout(tmp_path) / "poses.txt", pose_rows([POSES[0], lost, POSES[2]], lambda i, T: numbers(T)))
    posed(tmp_path, [POSES[0], None, POSES[2]])


@pytest.mark.parametrize("kind", ["color", "depth"])
def test_poses_without_numbers_are_of_the_images_in_order(tmp_path, kind):
    """A frame without its partner is left out and its pose with it."""
    layout(tmp_path)
    write_text(tmp_path / "poses.txt", pose_rows(POSES, lambda i, T: numbers(T)))
    (tmp_path / kind / "000001.png").unlink()
    posed(tmp_path, [POSES[0], POSES[2]])
    write_text(tmp_path / "poses.txt", pose_rows([*POSES, POSES[0]], lambda i, T: numbers(T)))
    with pytest.raises(RecordingError, match="expected 2 poses, as there are frames, got 4; put each frame's number"):
        open_recording(tmp_path)


def test_poses_without_numbers_are_of_all_numbers_where_either_list_lacks_images(tmp_path):
    poses = [POSES[0] @ camera_pose(2.0 * i, (0.01 * i, 0.0, 0.0)) for i in range(6)]
    layout(tmp_path, "color/{i:06d}.png", "depth/{i:06d}.png", poses=poses)
    (tmp_path / "color" / "000004.png").unlink()
    (tmp_path / "depth" / "000002.png").unlink()
    write_text(tmp_path / "poses.txt", "".join(" ".join(map(str, pose.ravel())) + "\n" for pose in poses))
    recording = open_recording(tmp_path)
    assert [entry.name for entry in recording.entries] == ["000000", "000001", "000003", "000005"]
    for entry in recording.entries:
        np.testing.assert_allclose(entry.T_world_camera, poses[int(entry.name)], rtol=0, atol=1e-9)


def test_poses_without_numbers_that_may_be_of_either_images_are_refused(tmp_path):
    four = [*POSES, camera_pose(20.0, (0.15, 0.3, 1.26))]
    layout(tmp_path, poses=four)
    write_text(tmp_path / "poses.txt", pose_rows(four, lambda i, T: numbers(T)))
    (tmp_path / "color/000003.png").rename(tmp_path / "color/000000a.png")
    (tmp_path / "color/000000.png").rename(tmp_path / "color/000009.png")
    (tmp_path / "color/000000a.png").rename(tmp_path / "color/000010.png")
    with pytest.raises(RecordingError, match="got 4, and colour and depth images count differently"):
        open_recording(tmp_path)


def test_a_pose_near_in_time_is_of_the_nearest_frame_only(tmp_path):
    """Poses that are rarer than frames: those between have none, and not their neighbour's."""
    layout(tmp_path, "color/{t:.6f}.png", "depth/{t:.6f}.png")
    quaternion = "0 0 0 0 0 0 1"
    write_text(tmp_path / "trajectory.txt", f"{1e9 + 0.006:.6f} {quaternion}\n{1e9 + 0.066:.6f} {quaternion}\n")
    poses = [entry.T_world_camera is not None for entry in open_recording(tmp_path).entries]
    assert poses == [True, False, True]


def test_numbers_with_decimal_commas_are_read(tmp_path):
    layout(tmp_path, K=("K.txt", MATRIX.replace(".", ",")))
    rows = [["time", "x", "y", "z", "qx", "qy", "qz", "qw"]]
    for i, pose in enumerate(POSES):
        rows.append([f"{i}", *(f"{x:.9f}" for x in (*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()))])
    write_text(tmp_path / "poses.csv", "\n".join(";".join(row).replace(".", ",") for row in rows))
    posed(tmp_path)
    is_the_room(open_recording(tmp_path))


def test_the_name_of_the_recording_says_nothing_of_its_poses(tmp_path):
    folder = tmp_path / "w2c_and_c2w"
    write_text(layout(folder) / "poses.txt", pose_rows(POSES, lambda i, T: numbers(np.linalg.inv(T))))
    posed(folder)


def test_numbers_that_no_camera_reaches_in_metres_are_millimetres(tmp_path):
    layout(tmp_path)
    for path in sorted((tmp_path / "depth").iterdir()):
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32)
        path.unlink()
        np.save(path.with_suffix(".npy"), depth)
    recording = open_recording(tmp_path)
    assert recording.notes == ("depth is taken for millimetres, no file says so",)
    assert 0.5 < np.nanmedian(recording.entries[0].load().depth_m()) < 10.0


def test_a_pose_file_a_frame_and_names_that_say_which_way(tmp_path):
    layout(tmp_path)
    (tmp_path / "w2c").mkdir()
    for i, pose in enumerate(POSES[:2]):
        np.savetxt(tmp_path / f"w2c/{i:06d}.txt", np.linalg.inv(pose))
    recording = open_recording(tmp_path)
    assert recording.notes[-1].endswith("are read as the inverse of camera to world: by their name")
    np.testing.assert_allclose(recording.entries[1].T_world_camera, POSES[1], rtol=0, atol=1e-6)
    assert recording.entries[2].T_world_camera is None


@pytest.mark.parametrize(("frames", "poses"), [(0, 1), (1, 0)])
@pytest.mark.parametrize("file", ["poses.txt", "poses/{:06d}.txt"])
def test_frames_that_are_counted_from_0_and_poses_from_1_belong_together(tmp_path, file, frames, poses):
    """Each frame had the pose of the next one, and the last had none."""
    layout(tmp_path, *("color/{i}.png", "depth/{i}.png") if frames == 0 else ("color/{n}.png", "depth/{n}.png"))
    if file == "poses.txt":
        write_text(tmp_path / file, pose_rows(POSES, lambda i, T: f"{i + poses} {numbers(T)}"))
    else:
        for i, pose in enumerate(POSES):
            write_text(tmp_path / file.format(i + poses), numbers(pose))
    posed(tmp_path)
    said = f"frames are counted from {frames} and their poses from {poses}: each has the pose of its place"
    assert said in open_recording(tmp_path).notes
    if file == "poses.txt":  # one frame has no pose: it cannot be told which
        write_text(tmp_path / file, pose_rows(POSES[:2], lambda i, T: f"{i + poses} {numbers(T)}"))
        assert said not in open_recording(tmp_path).notes


# Depth of another size, or of another camera

FINE = PinholeIntrinsics(320, 240, 280.0, 282.0, 158.5, 121.5)
T_COLOR_DEPTH = np.array([[1.0, 0, 0, 0.05], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def agrees(frame, pose, share=0.95):
    """Most of the frame's depth is what the room has there, and colours are on their surfaces."""
    color, depth = render(frame.intrinsics, pose)
    off = np.abs(frame.depth_m() - depth)
    assert np.isfinite(off).mean() > 0.8 and (off[np.isfinite(off)] < 0.02).mean() > share
    assert np.abs(frame.color.astype(int) - color)[10:-10, 10:-10].mean() < 6.0
    assert len(dense_cloud(frame).points) > 0.5 * depth.size


def test_coarse_depth_of_the_same_camera_is_drawn_out(tmp_path):
    for i, pose in enumerate(POSES):
        write_color(tmp_path / f"color/{i}.png", FINE, pose)
        write_depth(tmp_path / f"depth/{i}.png", SMALL, pose, 1000)
    write_json(tmp_path / "k.json", {"fx": 280, "fy": 282, "cx": 158.5, "cy": 121.5})
    frame = open_recording(tmp_path).entries[1].load()
    assert frame.intrinsics == FINE
    agrees(frame, POSES[1])


def test_much_finer_colour_is_made_smaller(tmp_path):
    coarse = PinholeIntrinsics(40, 30, 35.0, 35.25, 19.375, 14.75)
    for i, pose in enumerate(POSES):
        write_color(tmp_path / f"color/{i}.png", FINE, pose)
        write_depth(tmp_path / f"depth/{i}.png", coarse, pose, 1000)
    write_json(tmp_path / "k.json", {"fx": 280, "fy": 282, "cx": 158.5, "cy": 121.5})
    frame = open_recording(tmp_path).entries[1].load()
    assert frame.depth.shape == (80, 106)


@pytest.mark.parametrize("name", ["depth_to_color.txt", "T_depth_color.txt"])
def test_depth_of_another_camera_is_registered_to_the_colour(tmp_path, name):
    for i, pose in enumerate(POSES):
        write_color(tmp_path / f"color/{i}.png", FINE, pose)
        write_depth(tmp_path / f"depth/{i}.png", SMALL, pose @ T_COLOR_DEPTH, 1000)
    np.savetxt(tmp_path / "color_intrinsics.txt", FINE.matrix())
    np.savetxt(tmp_path / "depth_intrinsics.txt", SMALL.matrix())
    np.savetxt(tmp_path / name, T_COLOR_DEPTH if name.startswith("depth") else np.linalg.inv(T_COLOR_DEPTH))
    agrees(open_recording(tmp_path).entries[1].load(), POSES[1])


def test_a_rig_of_color_and_depth_calibrates_both(tmp_path):
    for i, pose in enumerate(POSES):
        write_color(tmp_path / f"color/{i}.png", FINE, pose)
        write_depth(tmp_path / f"depth/{i}.png", SMALL, pose @ T_COLOR_DEPTH, 1000)
    sensors = {
        "color": SensorCalibration("color", FINE, 1000.0, np.eye(4)),
        "depth": SensorCalibration("depth", SMALL, 1000.0, T_COLOR_DEPTH),
    }
    agrees(open_recording(tmp_path, rig=Rig("two", sensors)).entries[1].load(), POSES[1])


def test_a_lens_that_distorts_counts_in_registering(tmp_path):
    bent = PinholeIntrinsics(320, 240, 280.0, 282.0, 158.5, 121.5, (-0.2, 0.05, 0.0, 0.0))
    for i, pose in enumerate(POSES):
        write_color(tmp_path / f"color/{i}.png", bent, pose)
        write_depth(tmp_path / f"depth/{i}.png", SMALL, pose @ T_COLOR_DEPTH, 1000)
    sensors = {
        "color": SensorCalibration("color", bent, 1000.0, np.eye(4)),
        "depth": SensorCalibration("depth", SMALL, 1000.0, T_COLOR_DEPTH),
    }
    frame = open_recording(tmp_path, rig=Rig("two", sensors)).entries[1].load()
    off = np.abs(frame.depth_m() - render(bent, POSES[1])[1])
    assert np.isfinite(off).mean() > 0.7 and np.nanpercentile(off, 90) < 0.02


# Near misses


def refused(folder, match, **options):
    with pytest.raises(RecordingError, match=match) as caught:
        open_recording(folder, **options)
    assert str(folder) in str(caught.value) and "\n" not in str(caught.value)


def test_what_is_nearly_there_is_said(tmp_path):
    layout(tmp_path, K=None)
    refused(tmp_path, "nearly: 3 frames, colour in color/, depth in depth/, and no intrinsics; add intrinsics.json")
    rig = Rig("one", {"a": SensorCalibration("a", SMALL, 1000.0, None)})
    is_the_room(open_recording(tmp_path, rig=rig))
    for path in (tmp_path / "depth").iterdir():
        path.unlink()
    refused(tmp_path, "not a recording of a known format; it holds 2 folders, but no folder of colour and one of depth")


def test_mistakes_are_named(tmp_path):
    layout(tmp_path)
    (tmp_path / "traj.txt").write_text(pose_rows(POSES[:2], lambda i, T: numbers(T)))
    refused(tmp_path, r"traj\.txt: expected 3 poses, as there are frames, got 2")
    (tmp_path / "traj.txt").write_text(pose_rows(POSES, lambda i, T: numbers(2 * T)))
    refused(tmp_path, r"traj\.txt:1: pose: expected 0 0 0 1 in the last row")
    (tmp_path / "traj.txt").unlink()
    for K, match in (
        ('{"fx": 1e999, "fy": 1, "cx": 1, "cy": 1}', "fx: expected a finite number"),
        ('{"K": [[1, 2], [3, 4]]}', "expected a 3x3 or 4x4 matrix or fx fy cx cy, got 4 numbers"),
        ('{"K": [1, 2, "x"]}', "expected 3 finite numbers"),
        ('{"fx": 9, "fy": 9, "cx": 9, "cy": 9, "w": -5, "h": 7}', "expected an image size"),
        ("{", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
    ):
        (tmp_path / "k.json").write_text(K)
        (tmp_path / "K.txt").unlink(missing_ok=True)
        refused(tmp_path, match)


def test_a_cropped_image_is_no_scaled_one(tmp_path):
    layout(tmp_path, K=("k.json", json.dumps({"fx": 140, "fy": 141, "cx": 79, "cy": 60.5, "w": 160, "h": 90})))
    with pytest.raises(RecordingError, match="the intrinsics are for 160x90 pixels, which is no scaled 160x120"):
        open_recording(tmp_path).entries[0].load()


def test_colour_and_depth_of_different_shapes_need_both_calibrations(tmp_path):
    layout(tmp_path)
    for path in (tmp_path / "depth").iterdir():
        assert cv2.imwrite(str(path), depth_of(SMALL, POSES[0], 1000)[:100])
    with pytest.raises(RecordingError, match="no scaled view of one camera; give both cameras' calibrations"):
        open_recording(tmp_path).entries[0].load()


def test_a_folder_of_recordings_is_none_itself(tmp_path):
    layout(tmp_path / "first")
    layout(tmp_path / "second", "frame-{i:06d}.color.png", "frame-{i:06d}.depth.png")
    write_tum(tmp_path / "third", POSES[:2], SMALL)
    refused(tmp_path, "not a recording itself; name one of those in it, .*/first and others")
    assert recordings_in(tmp_path) == [tmp_path / name for name in ("first", "second", "third")]
    assert recordings_in(tmp_path / "first") == []
    (tmp_path / "alone").mkdir()
    (tmp_path / "third").rename(tmp_path / "alone" / "third")
    assert recordings_in(tmp_path / "alone") == [tmp_path / "alone" / "third"]


# Names


@pytest.mark.parametrize(
    ("color", "depth"),
    [
        ("jetson_{i:04d}_color.png", "jetson_{i:04d}_depth.png"),
        ("visit2_{i:03d}.png", "visit2_{i:03d}_depth.png"),
        ("config_{i}_rgb.png", "config_{i}_depth.png"),
        ("color/2024-05-01_12-00-0{i}_123.png", "depth/2024-05-01_12-00-0{i}_140.png"),
        # Equal last numbers of other seconds are no partners.
        ("color/20240501_12000{i}_0{i}0.png", "depth/20240501_12000{i}_0{i}7.png"),
        ("color/2024-05-01T12-00-59.9{i}5.png", "depth/2024-05-01T12-00-59.9{i}1.png"),
    ],
)
def test_words_are_whole_and_dates_are_times(tmp_path, color, depth):
    is_the_room(open_recording(layout(tmp_path, color, depth)))


@pytest.mark.parametrize("name", ["depth_vis", "depthVis", "depthvis", "depth_masks", "confidence_depth", "depth_IR"])
def test_what_only_shows_depth_is_no_depth(tmp_path, name):
    layout(tmp_path)
    for i, pose in enumerate(POSES * 2):
        write_color(tmp_path / f"{name}/{i:06d}.png", SMALL, pose)
    is_the_room(open_recording(tmp_path))


def test_a_word_within_another_names_no_folder_of_depth(tmp_path):
    layout(tmp_path)
    for i, pose in enumerate(POSES * 2):
        write_color(tmp_path / f"strange_display/{i:06d}.png", SMALL, pose)
    (tmp_path / "depth").rename(tmp_path / "tof2")
    is_the_room(open_recording(tmp_path))


def test_times_without_zeros_before_milliseconds_and_minutes_that_turn(tmp_path):
    stamps = ["2024-05-01_12-00-59_995", "2024-05-01_12-01-00_27", "2024-05-01_12-01-00_60"]
    later = ["2024-05-01_12-01-00_4", "2024-05-01_12-01-00_36", "2024-05-01_12-01-00_69"]
    layout(tmp_path)
    for i, (color, depth) in enumerate(zip(stamps, later, strict=True)):
        (tmp_path / f"color/{i:06d}.png").rename(tmp_path / f"color/{color}.png")
        (tmp_path / f"depth/{i:06d}.png").rename(tmp_path / f"depth/{depth}.png")
    recording = open_recording(tmp_path)
    is_the_room(recording)
    assert [entry.name for entry in recording.entries] == later


def test_folders_that_are_links_count_within_the_recording_and_are_named_without(tmp_path):
    layout(tmp_path / "scan" / "raw_data")
    (tmp_path / "scan" / "raw_data" / "K.txt").rename(tmp_path / "scan" / "K.txt")
    for name in ("color", "depth"):
        (tmp_path / "scan" / name).symlink_to(tmp_path / "scan" / "raw_data" / name)
    is_the_room(open_recording(tmp_path / "scan"))
    (tmp_path / "scan" / "raw_data").rename(tmp_path / "elsewhere")
    for name in ("color", "depth"):
        (tmp_path / "scan" / name).unlink()
        (tmp_path / "scan" / name).symlink_to(tmp_path / "elsewhere" / name)
    refused(tmp_path / "scan", r"color/000000\.png' leads out of the recording folder .* move the file into it")


@pytest.mark.parametrize("kind", ["color", "depth"])
def test_a_first_image_that_is_bad_spoils_its_frame_alone(tmp_path, kind):
    layout(tmp_path)
    bad = tmp_path / kind / "000000.png"
    bad.write_bytes(bad.read_bytes()[:500])
    recording = open_recording(tmp_path)
    with pytest.raises(RecordingError, match=r"000000\.png: the image is cut off"):
        recording.entries[0].load()
    assert recording.entries[1].load().intrinsics == SMALL
    for path in (tmp_path / kind).iterdir():
        path.write_bytes(b"")
    refused(tmp_path, r"000000\.png: expected a PNG or JPEG image, it is empty")
