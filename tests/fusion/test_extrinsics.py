"""Poses that are inverted, transposed, in millimetres or in another camera's axes are named by what they look like."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from depth_scene import camera_pose, render
from reader_cases import write_own
from scipy.spatial.transform import Rotation
from shared_data import ROOT

from adagmm_fusion.cli import main
from adagmm_fusion.frames.pose_readings import (
    AS_GIVEN,
    OPENGL,
    READINGS,
    PosedPair,
    agreeing_share,
    best_reading,
    sampled_points,
)
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.recordings.opening import open_recording
from adagmm_fusion.rigs.extrinsics import extrinsics_notes
from adagmm_fusion.rigs.rig import Rig, SensorCalibration, load_rig, save_rig
from adagmm_o3d.lie import se_inverse

SMALL = PinholeIntrinsics(160, 120, 140.0, 141.0, 79.0, 60.5)
POSES = [camera_pose(-9.0), camera_pose(9.0, (0.2, 0.3, 1.3))]


def frame_at(pose, name="frame"):
    color, depth = render(SMALL, pose)
    return RGBDFrame(name, color, depth, SMALL, 1.0, name)


FRAMES = [frame_at(pose) for pose in POSES]


def multiplied(T, by):
    T = T.copy()
    T[:3, 3] *= by
    return T


def transposed(T):
    T = T.copy()
    T[:3, :3] = T[:3, :3].T
    return T


def w_first(T):
    """What (w, x, y, z) gives where (x, y, z, w) is expected."""
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    T = T.copy()
    T[:3, :3] = Rotation.from_quat((w, x, y, z)).as_matrix()
    return T


# What was written instead of T_world_camera, by what it is to be taken for.
MISTAKES = {
    AS_GIVEN: lambda T: T,
    "the inverse": se_inverse,
    "with its rotation transposed": transposed,
    "in millimetres": lambda T: multiplied(T, 1000.0),
    "the inverse, in millimetres": lambda T: multiplied(se_inverse(T), 1000.0),
    "in centimetres": lambda T: multiplied(T, 100.0),
    "with its translation the other way": lambda T: multiplied(T, -1.0),
    "with w first in its quaternion": w_first,
    "the inverse, with w first in its quaternion": lambda T: w_first(se_inverse(T)),
    "of a camera with y up and z backward": lambda T: T @ OPENGL,
    "the inverse, of a camera with y up and z backward": lambda T: se_inverse(T @ OPENGL),
}


def test_every_reading_is_tried_here():
    assert set(MISTAKES) == set(READINGS)


@pytest.mark.parametrize("name", MISTAKES)
def test_the_depth_images_tell_how_a_pose_is_meant(name):
    given = [MISTAKES[name](pose) for pose in POSES]
    best = best_reading([PosedPair(FRAMES[1], FRAMES[0], given[1], given[0])])
    assert best.name == name and best.share > 0.4
    for pose, T in zip(given, POSES, strict=True):
        np.testing.assert_allclose(READINGS[name](pose), T, rtol=0, atol=1e-9)


def test_where_no_reading_is_clearly_better_the_given_one_stays():
    assert best_reading([]).name == AS_GIVEN
    apart = [camera_pose(0.0), camera_pose(170.0)]  # they see nothing in common
    frames = [frame_at(pose) for pose in apart]
    assert best_reading([PosedPair(frames[1], frames[0], apart[1], apart[0])]).name == AS_GIVEN


def test_a_sensor_that_was_moved_is_not_taken_for_millimetres(tmp_path):
    """Read so, both sensors are at one place, which near sensors agree with."""
    near = [POSES[0], POSES[0].copy()]
    near[1][:3, 3] += 0.02
    write_own(tmp_path, near, SMALL)
    rig = load_rig(tmp_path / "rig.yaml")
    moved = dict(rig.sensors)
    T = moved["right"].T_rig_sensor.copy()
    T[:3, 3] += 0.4
    moved["right"] = replace(moved["right"], T_rig_sensor=T)
    save_rig(tmp_path / "rig.yaml", Rig(rig.name, moved))
    (note,) = extrinsics_notes(open_recording(tmp_path))
    assert note.startswith("the pose of right to left does not fit: as given ") and "millimetres" not in note


def test_the_share_of_agreeing_points_is_the_overlap():
    points = sampled_points(FRAMES[0])
    assert agreeing_share(points, FRAMES[0], np.eye(4)) == 1.0
    shifted = np.eye(4)
    shifted[2, 3] = 0.5
    assert agreeing_share(points, FRAMES[0], shifted) < 0.1
    assert agreeing_share(points[:0], FRAMES[0], np.eye(4)) == 0.0


@pytest.mark.parametrize("name", ["the inverse", "in millimetres", "in centimetres"])
def test_a_rig_whose_extrinsics_are_meant_otherwise(tmp_path, name):
    write_own(tmp_path, [np.eye(4), se_inverse(POSES[0]) @ POSES[1]], SMALL)
    for sensor, pose in zip(("left", "right"), POSES, strict=True):
        color, depth = render(SMALL, pose)
        assert cv2.imwrite(str(tmp_path / sensor / "color/000000.png"), color)
        assert cv2.imwrite(str(tmp_path / sensor / "depth/000000.png"), (1000 * depth).astype(np.uint16))
    assert extrinsics_notes(open_recording(tmp_path)) == ()
    rig = load_rig(tmp_path / "rig.yaml")
    right = rig.sensors["right"]
    wrong = SensorCalibration("right", right.intrinsics, 1000.0, MISTAKES[name](right.T_rig_sensor))
    save_rig(tmp_path / "rig.yaml", Rig(rig.name, rig.sensors | {"right": wrong}))
    (note,) = extrinsics_notes(open_recording(tmp_path))
    assert note.startswith(f"the pose of right to left looks like {name}: ")


@pytest.mark.slow
def test_verify_and_info_say_so(tmp_path, capsys):
    rig = load_rig(ROOT / "calibration" / "two_kinects.yaml")
    right = rig.sensors["right"]
    inverse = SensorCalibration("right", right.intrinsics, right.depth_scale, se_inverse(right.T_rig_sensor))
    save_rig(tmp_path / "rig.yaml", Rig(rig.name, rig.sensors | {"right": inverse}))
    recording = str(ROOT / "recordings" / "two_kinects")
    main(["verify", str(tmp_path / "rig.yaml"), recording, "--frames", "2", "--device", "cpu"])
    assert "right to left looks like the inverse" in capsys.readouterr().out
    main(["info", recording, "--calibration", str(tmp_path / "rig.yaml")])
    assert "right to left looks like the inverse" in capsys.readouterr().out
    main(["info", recording])
    assert "looks like" not in capsys.readouterr().out
