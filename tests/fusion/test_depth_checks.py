"""Depth whose planes are not straight in its inverse is no depth along the optical axis; what else bends it is told
from that."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from depth_scene import camera_pose, render

from adagmm_fusion.frames.depth_checks import looks_like_disparity
from adagmm_fusion.frames.rgbd import PinholeIntrinsics, RGBDFrame

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
