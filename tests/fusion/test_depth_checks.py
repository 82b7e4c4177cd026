"""Depth whose planes are not straight in its inverse is no depth along the optical axis; what else bends it is told
from that."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from depth_scene import camera_pose, render
from shared_data import ROOT, shared_data

from adagmm_fusion.frames.depth_checks import looks_like_disparity, looks_like_distance
from adagmm_fusion.frames.depth_geometry import pixel_rays
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame
from adagmm_fusion.pairs.plausibility import sensor_warnings
from adagmm_fusion.recordings.opening import open_recording
from adagmm_o3d.errors import InputError

CAMERA = PinholeIntrinsics(320, 240, 262.0, 262.0, 159.5, 119.5)


def rendered(intrinsics=CAMERA) -> list[RGBDFrame]:
    """Four directions in a room, in millimetres."""
    frames = []
    for yaw in (0.0, 60.0, 150.0, 250.0):
        color, depth = render(intrinsics, camera_pose(yaw))
        frames.append(RGBDFrame("a", color, np.round(depth * 1000).astype(np.uint16), intrinsics, 1000.0, "camera"))
    return frames


@pytest.fixture(scope="module")
def room():
    return rendered()


def disparity(frame):
    return replace(frame, depth=np.round(4e6 / frame.depth).astype(np.uint16))


def distance(frame):
    """Multiplied by |ray|, as simulators and time of flight measure."""
    lengths = np.sqrt(1.0 + (pixel_rays(frame.intrinsics) ** 2).sum(axis=-1))
    return replace(frame, depth=(frame.depth * lengths).round().clip(0, 65535).astype(frame.depth.dtype))


def resized_with_holes(frame):
    """Halved and doubled with interpolation, which takes the zeros of holes for depth."""
    depth = frame.depth.copy()
    holes = (np.random.default_rng(0).random(depth.shape) < 0.002).astype(np.uint8)
    depth[cv2.dilate(holes, np.ones((3, 3))) > 0] = 0
    small = cv2.resize(depth, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_LINEAR)
    return replace(frame, depth=cv2.resize(small, depth.shape[::-1], interpolation=cv2.INTER_LINEAR))


def test_interpolated_depth_is_no_disparity(room):
    """Pixels between depth and nothing are near: they make planes slanted that are not, and straight in depth."""
    assert not looks_like_disparity([resized_with_holes(frame) for frame in room])
    assert looks_like_disparity([resized_with_holes(disparity(frame)) for frame in room])


@pytest.mark.parametrize("focal", [100.0, 160.0, 262.0])
def test_distance_along_the_ray_is_no_depth(focal):
    """Views of 116°, 90° and 63°."""
    room = rendered(PinholeIntrinsics(320, 240, focal, focal, 159.5, 119.5))
    along = [distance(frame) for frame in room]
    assert not looks_like_distance(room) and looks_like_distance(along)
    assert not looks_like_disparity(along) and not looks_like_distance([disparity(frame) for frame in room])
    (warning,) = [text for text in sensor_warnings(along) if "distance" in text]
    assert warning == (
        "the depth looks like the distance along the ray: planes are straight if it is divided by the length of the "
        "ray, |(x, y, 1)|; convert it to depth along the optical axis"
    )
    assert not any("distance" in text for text in sensor_warnings(room))


def test_distance_along_the_ray_with_lens_distortion():
    room = rendered(PinholeIntrinsics(320, 240, 200.0, 200.0, 159.5, 119.5, (-0.2, 0.05, 0.0, 0.0)))
    assert not looks_like_distance(room) and looks_like_distance([distance(frame) for frame in room])


def test_without_planes_nothing_is_said_of_distance(room):
    assert not looks_like_distance([])
    noise = np.random.default_rng(1).normal(1.0, 0.1, room[0].depth.shape)
    rough = [replace(frame, depth=(frame.depth * noise).astype(np.uint16)) for frame in room]
    assert not looks_like_distance([distance(frame) for frame in rough])
    holes = np.random.default_rng(2).random(room[0].depth.shape) < 0.3
    sparse = [replace(frame, depth=np.where(holes, 0, frame.depth).astype(np.uint16)) for frame in room]
    assert not looks_like_distance([distance(frame) for frame in sparse])


def test_without_rays_nothing_is_said_of_distance(room):
    """A distortion that folds over inside the image."""
    folded = PinholeIntrinsics(320, 240, 160.0, 160.0, 159.5, 119.5, (-2.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="folds"):
        pixel_rays(folded)
    assert not looks_like_distance([replace(frame, intrinsics=folded) for frame in room])


def some_frames(recording, sensor):
    own = [entry for entry in recording.entries if entry.sensor == sensor]
    return [entry.load() for entry in own[:: max(len(own) // 3, 1)]]


@pytest.mark.slow
def test_distance_of_a_kinect():
    """The shipped recording's: rendered with the steps and noise of structured light."""
    recording = open_recording(ROOT / "recordings" / "two_kinects")
    for sensor in ("left", "right"):
        frames = some_frames(recording, sensor)
        assert not looks_like_distance(frames) and looks_like_distance([distance(frame) for frame in frames])


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["hololens_tof", "redwood_open3d_5frames", "tum_fr1_rpy_kinect_v1", "two_xtion_rig", "apc_shelf_f200"]
)
def test_distance_of_real_sensors(name):
    """The F200's shelf shows no plane without holes, of which nothing can be said."""
    recording = open_recording(shared_data("recordings", name))
    for sensor in recording.sensors:
        frames = some_frames(recording, sensor)
        assert not looks_like_distance(frames)
        assert looks_like_distance([distance(frame) for frame in frames]) == (name != "apc_shelf_f200")
